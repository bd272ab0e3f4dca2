// SPDX-License-Identifier: Apache-2.0
// An interactive view of the points in a page; without WebGL the still image stays.
'use strict';


function showCloud(root) {
  const meta = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const canvas = root.querySelector('canvas');
  const gl = canvas.getContext('webgl', { antialias: true });
  if (!gl) return;
  const points = decode(meta, root.querySelector('script[type="text/plain"]').textContent);
  const program = compile(gl);
  const place = name => gl.getUniformLocation(program, name);
  const uniforms = { view: place('view'), eye: place('eye'), size: place('size'), mark: place('mark') };
  attribute(gl, program, 'position', points.shown, 3, gl.FLOAT, false);
  const colours = attribute(gl, program, 'colour', points.rgb, 3, gl.UNSIGNED_BYTE, true);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(0.118, 0.133, 0.157, 1);
  root.classList.add('live');

  const camera = meta.eye.map(Number), home = start(points.middle, camera);
  let state = { ...home, target: [...home.target] }, factor = 1, picked = -1;
  const select = root.querySelector('select'), bar = root.querySelector('.bar');
  const output = root.querySelector('output');

  function paint() {
    const [values, unit] = points.modes[select.value];
    let rgb = points.rgb;
    bar.textContent = '';
    if (values) {
      const [low, high] = limits(values);
      rgb = new Uint8Array(3 * meta.count);
      for (let i = 0; i < meta.count; i++) {
        rgb.set(turbo((values[i] - low) / (high - low || 1)), 3 * i);
      }
      const stripe = document.createElement('i');
      const stops = [0, 0.25, 0.5, 0.75, 1].map(x => `rgb(${turbo(x)})`);
      stripe.style.background = `linear-gradient(to right, ${stops})`;
      const ends = select.value === 'measured' ? ['filled', 'measured']
        : [low, high].map(value => `${value.toFixed(unit === 'mm' ? 0 : 2)} ${unit}`);
      bar.append(ends[0], stripe, ends[1]);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, colours);
    gl.bufferData(gl.ARRAY_BUFFER, rgb, gl.STATIC_DRAW);
    draw();
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(uniforms.view, false, matrix(state, canvas.width / canvas.height));
    gl.uniform3fv(uniforms.eye, camera);
    gl.uniform1f(uniforms.size, factor * meta.gap * canvas.height * FOCAL / 2);
    gl.uniform1f(uniforms.mark, 0);
    gl.drawArrays(gl.POINTS, 0, meta.count);
    if (picked >= 0) {
      gl.uniform1f(uniforms.mark, 9 * ratio);
      gl.drawArrays(gl.POINTS, picked, 1);
    }
  }

  function pick(x, y) {
    const m = matrix(state, canvas.clientWidth / canvas.clientHeight), p = points.shown;
    let best = Infinity;
    picked = -1;
    for (let i = 0; i < meta.count; i++) {
      const [a, b, c] = [p[3 * i], p[3 * i + 1], p[3 * i + 2]];
      const w = m[3] * a + m[7] * b + m[11] * c + m[15];
      if (w <= 0) continue;
      const u = (m[0] * a + m[4] * b + m[8] * c + m[12]) / w;
      const v = (m[1] * a + m[5] * b + m[9] * c + m[13]) / w;
      const off = Math.hypot((u + 1) / 2 * canvas.clientWidth - x,
        (1 - v) / 2 * canvas.clientHeight - y);
      // of the points near the click the foremost
      const score = off < 6 ? w : off < 20 ? 1e6 * off : Infinity;
      if (score < best) { best = score; picked = i; }
    }
    output.textContent = picked < 0 ? '' : meta.names.map((name, axis) =>
      `${name} ${(meta.low[axis] + meta.step[axis] * points.raw[axis][picked]).toFixed(3)}`
    ).join('   ') + ` m, ${meta.sigma_name} ${points.sigma[picked].toFixed(3)} m, ` +
      (points.measured[picked] ? 'measured' : 'filled');
    draw();
  }

  function turn(dx, dy) {
    state.yaw -= 0.005 * dx;
    state.pitch = Math.max(-1.55, Math.min(1.55, state.pitch + 0.005 * dy));
  }
  function shift(dx, dy) {
    const [right, up] = axes(state), k = 2 * state.distance / FOCAL / canvas.clientHeight;
    state.target = state.target.map((value, i) => value - k * dx * right[i] + k * dy * up[i]);
  }
  const zoom = by => { state.distance = Math.max(0.3, Math.min(2000, state.distance * by)); };
  const fingers = new Map();
  let moved = 0;
  canvas.addEventListener('pointerdown', event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    moved = 0;
  });
  canvas.addEventListener('pointermove', event => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last.clientX, event.clientY - last.clientY];
    moved += Math.abs(dx) + Math.abs(dy);
    if (fingers.size === 2) {
      const other = [...fingers.values()].find(one => one.pointerId !== event.pointerId);
      const apart = one => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      zoom(apart(last) / Math.max(apart(event), 1));
      shift(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) shift(dx, dy);
    else turn(dx, dy);
    fingers.set(event.pointerId, event);
    draw();
  });
  const release = event => {
    if (fingers.delete(event.pointerId) && event.type === 'pointerup' && moved < 4) {
      pick(event.offsetX, event.offsetY);
    }
  };
  canvas.addEventListener('pointerup', release);
  canvas.addEventListener('pointercancel', release);
  canvas.addEventListener('contextmenu', event => event.preventDefault());
  canvas.addEventListener('wheel', event => {
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
    draw();
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turn(-20, 0), ArrowRight: () => turn(20, 0), ArrowUp: () => turn(0, 20),
    ArrowDown: () => turn(0, -20), '+': () => zoom(0.9), '-': () => zoom(1.1),
  };
  canvas.addEventListener('keydown', event => {
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
    draw();
  });
  const views = {
    camera: () => ({ ...facing(points.middle, camera), target: [...points.middle] }),
    top: () => ({ ...home, pitch: 1.55, target: [...points.middle] }),
    side: () => ({ ...home, yaw: home.yaw + Math.PI / 2, pitch: 0.1, target: [...points.middle] }),
    start: () => ({ ...home, target: [...home.target] }),
  };
  for (const button of root.querySelectorAll('button[value]')) {
    button.addEventListener('click', () => {
      if (button.value in views) state = views[button.value]();
      else factor = Math.max(0.3, Math.min(6, factor * (button.value === 'larger' ? 1.3 : 0.77)));
      draw();
    });
  }
  select.addEventListener('change', paint);
  new ResizeObserver(draw).observe(canvas);
  paint();
}

// Half the height of the image at the distance 1 is 1 / FOCAL.
const FOCAL = 2.4;

function decode(meta, text) {
  const n = meta.count, bytes = Uint8Array.from(atob(text.trim()), c => c.charCodeAt(0));
  const words = k => new Uint16Array(bytes.buffer, 2 * n * k, n);
  const octets = k => new Uint8Array(bytes.buffer, 8 * n + n * k, n);
  const raw = [0, 1, 2].map(words), sigma = Float32Array.from(words(3), v => v * meta.sigma_step);
  const shown = new Float32Array(3 * n), rgb = new Uint8Array(3 * n);
  const planes = [0, 1, 2].map(octets), depth = new Float32Array(n), height = new Float32Array(n);
  for (let i = 0; i < n; i++) {
    for (let row = 0; row < 3; row++) {
      let value = 0;
      for (let axis = 0; axis < 3; axis++) {
        value += meta.display[row][axis] *
          (meta.low[axis] - meta.origin[axis] + meta.step[axis] * raw[axis][i]);
      }
      shown[3 * i + row] = value;
      rgb[3 * i + row] = planes[row][i];
    }
    height[i] = shown[3 * i + 2] + meta.height_origin;
    depth[i] = Math.hypot(...[0, 1, 2].map(k => shown[3 * i + k] - meta.eye[k]));
  }
  const median = k => Float32Array.from({ length: n }, (_, i) => shown[3 * i + k]).sort()[n >> 1];
  const modes = {
    colour: [null, ''], height: [height, 'm'], distance: [depth, 'm'],
    sigma: [sigma.map(v => 1000 * v), 'mm'], measured: [octets(3), ''],
  };
  return { raw, shown, rgb, sigma, measured: octets(3), modes, middle: [0, 1, 2].map(median) };
}

function limits(values) {
  const sorted = Float32Array.from(values).sort(), at = q => sorted[Math.floor(q * (sorted.length - 1))];
  return values instanceof Uint8Array ? [0, 1] : [at(0.01), at(0.99)];
}

function turbo(share) {
  const x = Math.max(0.05, Math.min(0.95, share));
  const series = c => c.reduceRight((sum, one) => sum * x + one, 0);
  return [
    [0.13572138, 4.6153926, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
    [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
    [0.1066733, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
  ].map(c => Math.round(255 * Math.max(0, Math.min(1, series(c)))));
}

// Yaw 0 looks along y, pitch 0 is level; the eye is at the distance behind the target.
function facing(target, eye) {
  const [x, y, z] = target.map((value, i) => value - eye[i]);
  return { yaw: Math.atan2(-x, y), pitch: Math.atan2(-z, Math.hypot(x, y)),
    distance: Math.max(0.5, Math.hypot(x, y, z)), target };
}

function start(target, eye) {
  const seen = facing(target, eye);
  return { ...seen, yaw: seen.yaw - 0.25, pitch: seen.pitch + 0.12 };
}

function axes(state) {
  const [cy, sy, cp, sp] = [Math.cos(state.yaw), Math.sin(state.yaw),
    Math.cos(state.pitch), Math.sin(state.pitch)];
  return [[cy, sy, 0], [-sy * sp, cy * sp, cp], [-sy * cp, cy * cp, -sp]];
}

function matrix(state, aspect) {
  const [right, up, ahead] = axes(state), t = state.target;
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const near = 0.02 * state.distance, far = 50 * state.distance + 200;
  const a = (far + near) / (far - near), b = -2 * far * near / (far - near);
  const z = state.distance - dot(ahead, t), m = new Float32Array(16);
  for (let k = 0; k < 3; k++) {
    m[4 * k] = FOCAL / aspect * right[k];
    m[4 * k + 1] = FOCAL * up[k];
    m[4 * k + 2] = a * ahead[k];
    m[4 * k + 3] = ahead[k];
  }
  m[12] = -FOCAL / aspect * dot(right, t);
  m[13] = -FOCAL * dot(up, t);
  m[14] = a * z + b;
  m[15] = z;
  return m;
}

function compile(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, `
    attribute vec3 position; attribute vec3 colour; varying vec3 shade;
    uniform mat4 view; uniform vec3 eye; uniform float size; uniform float mark;
    void main() {
      gl_Position = view * vec4(position, 1.0);
      shade = mark > 0.0 ? vec3(1.0, 0.1, 0.9) : colour;
      if (mark > 0.0) gl_Position.z -= 0.002 * gl_Position.w;
      gl_PointSize = mark > 0.0 ? mark
        : clamp(size * distance(position, eye) / gl_Position.w, 1.0, 24.0);
    }`], [gl.FRAGMENT_SHADER, `
    precision mediump float; varying vec3 shade;
    void main() { gl_FragColor = vec4(shade, 1.0); }`]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  return program;
}

function attribute(gl, program, name, values, size, type, normalized) {
  const buffer = gl.createBuffer(), place = gl.getAttribLocation(program, name);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, size, type, normalized, 0, 0);
  return buffer;
}

for (const root of document.querySelectorAll('.cloud')) showCloud(root);
