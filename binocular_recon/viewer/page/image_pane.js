// SPDX-License-Identifier: Apache-2.0
// An image of the pair with what was picked and measured in it: zoom, pan and click.

const PICK = '#ff7828', CHOSEN = '#ffffff', LINE = '#ffd640', HOT = '#7df9ff';
const REACH_PX = 9, DRAG_PX = 4, CLOSEST = 40;

export class ImagePane {
  // events: click(u, v), take(name), hover({u, v, pick, x, y} or null)
  constructor(canvas, events, side = 'left') {
    this.canvas = canvas;
    this.side = side;
    this.events = events;
    this.image = null;
    this.state = null;
    this.hot = null; // name of a pick or measurement that is pointed at
    this.cursor = null;
    this.fitted = true;
    this.scale = 1;
    this.x = this.y = 0; // where the middle of the first pixel is, CSS px
    this.pressed = null;
    new ResizeObserver(() => this.resized()).observe(canvas);
    canvas.addEventListener('wheel', (event) => this.wheel(event), {passive: false});
    canvas.addEventListener('pointerdown', (event) => this.down(event));
    canvas.addEventListener('pointermove', (event) => this.move(event));
    canvas.addEventListener('pointerup', (event) => this.up(event));
    canvas.addEventListener('pointercancel', () => { this.pressed = null; });
    canvas.addEventListener('pointerleave', () => {
      this.cursor = null;
      events.hover(null);
      this.draw();
    });
  }

  show(state) {
    const source = state.shown[this.side];
    if (source && this.state?.shown[this.side] !== source) this.load(source);
    this.state = state;
    if (this.fitted) this.fit(); else this.draw();
  }

  load(source) {
    const image = new Image();
    image.onload = () => {
      if (this.state.shown[this.side] !== source) return; // another one is on its way
      this.image = image;
      this.draw();
    };
    image.src = source;
  }

  resized() {
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.canvas.clientWidth * ratio);
    this.canvas.height = Math.round(this.canvas.clientHeight * ratio);
    if (this.fitted) this.fit(); else this.draw();
  }

  fit() {
    if (!this.state) return;
    const [width, height] = this.state.shown.size;
    const {clientWidth, clientHeight} = this.canvas;
    this.scale = Math.min(clientWidth / width, clientHeight / height);
    this.x = (clientWidth - (width - 1) * this.scale) / 2;
    this.y = (clientHeight - (height - 1) * this.scale) / 2;
    this.fitted = true;
    this.draw();
  }

  // Image pixel to canvas, and back.
  place(u, v) { return [this.x + u * this.scale, this.y + v * this.scale]; }
  pixel(x, y) { return [(x - this.x) / this.scale, (y - this.y) / this.scale]; }

  wheel(event) {
    event.preventDefault();
    if (!this.state) return;
    const {offsetX: x, offsetY: y} = event;
    const [u, v] = this.pixel(x, y);
    const [width, height] = this.state.shown.size;
    const least = 0.5 * Math.min(this.canvas.clientWidth / width, this.canvas.clientHeight / height);
    const wanted = this.scale * Math.exp(-event.deltaY / (event.deltaMode ? 12 : 400));
    this.scale = Math.min(CLOSEST, Math.max(least, wanted));
    this.x = x - u * this.scale;
    this.y = y - v * this.scale;
    this.fitted = false;
    this.draw();
  }

  down(event) {
    if (event.button > 1) return;
    this.canvas.focus();
    this.canvas.setPointerCapture(event.pointerId);
    this.pressed = {x: event.offsetX, y: event.offsetY, dragged: event.button === 1};
  }

  move(event) {
    const {offsetX: x, offsetY: y} = event;
    if (this.pressed) {
      const [across, down] = [x - this.pressed.x, y - this.pressed.y];
      if (this.pressed.dragged || Math.hypot(across, down) > DRAG_PX) {
        this.x += across;
        this.y += down;
        this.pressed = {x, y, dragged: true};
        this.fitted = false;
      }
    }
    this.cursor = [x, y];
    const [u, v] = this.pixel(x, y);
    this.events.hover({u, v, x, y, pick: this.pickAt(x, y)});
    this.draw();
  }

  up(event) {
    const clicked = this.pressed && !this.pressed.dragged;
    this.pressed = null;
    if (!clicked || !this.state) return;
    const pick = this.pickAt(event.offsetX, event.offsetY);
    const [u, v] = this.pixel(event.offsetX, event.offsetY);
    const [width, height] = this.state.shown.size;
    if (pick) this.events.take(pick.name);
    else if (u > -0.5 && v > -0.5 && u < width - 0.5 && v < height - 0.5) {
      this.events.click(Math.min(width - 1, Math.max(0, u)), Math.min(height - 1, Math.max(0, v)));
    }
  }

  picksHere() { // those that have a place in this image
    const here = (pick) => pick.frame === this.state.shown.frame && pick[this.side];
    return this.state?.picks.filter(here) ?? [];
  }

  pickAt(x, y) {
    const away = (pick) => {
      const [px, py] = this.place(...pick[this.side]);
      return Math.hypot(px - x, py - y);
    };
    const near = this.picksHere().filter((pick) => away(pick) < REACH_PX);
    return near.sort((one, other) => away(one) - away(other))[0] ?? null;
  }

  draw() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = null;
      this.paint();
    });
  }

  paint() {
    const context = this.canvas.getContext('2d');
    const ratio = window.devicePixelRatio || 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    if (!this.state) return;
    if (this.image) {
      const [width, height] = this.state.shown.size;
      const [x, y] = this.place(-0.5, -0.5);
      context.imageSmoothingEnabled = this.scale < 3;
      context.drawImage(this.image, x, y, width * this.scale, height * this.scale);
    }
    const picks = new Map(this.picksHere().map((pick) => [pick.name, pick]));
    const places = (names) => names.map((name) => picks.get(name)).filter(Boolean)
      .map((pick) => this.place(...pick[this.side]));
    for (const one of this.state.measurements) {
      const line = places(one.points);
      if (one.points.length > 1 && line.length === one.points.length) {
        this.line(context, line, one.closed, one.name === this.hot ? HOT : LINE);
      }
    }
    const open = places(this.state.chosen);
    if (open.length) {
      if (this.cursor) open.push(this.cursor);
      this.line(context, open, false, CHOSEN, [6, 5]);
    }
    const {awaited} = this.state;
    if (awaited && this.side === 'left') this.pick(context, awaited);
    else if (awaited) { // it is on the same row
      const [, y] = this.place(...awaited.left);
      this.line(context, [[0, y], [this.canvas.clientWidth, y]], false, CHOSEN, [6, 5]);
    }
    for (const pick of picks.values()) this.pick(context, pick);
    for (const one of this.state.measurements) { // values lie above all else
      const line = places(one.points);
      if (one.label && one.points.length > 1 && line.length === one.points.length) {
        const ends = one.closed ? line : [line[0], line.at(-1)];
        const middle = [0, 1].map((i) => ends.reduce((sum, end) => sum + end[i], 0) / ends.length);
        if (!one.closed) { // beside the line
          const [across, down] = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
          const length = Math.hypot(across, down) || 1;
          const side = across < 0 ? -1 : 1;
          const width = context.measureText(one.label).width / 2;
          middle[0] -= side * down / length * (width + 14);
          middle[1] += side * across / length * 20;
        }
        this.text(context, one.label, ...middle, 'center', 15);
      }
    }
  }

  line(context, line, closed, colour, dashes = []) {
    context.beginPath();
    line.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    if (closed) context.closePath();
    context.setLineDash(dashes);
    context.lineJoin = 'round';
    for (const [style, width] of [['#000a', 4.5], [colour, 2]]) {
      context.strokeStyle = style;
      context.lineWidth = width;
      context.stroke();
    }
    context.setLineDash([]);
  }

  pick(context, pick) {
    const [x, y] = this.place(...pick[this.side]);
    const colour = pick.name === this.hot ? HOT
      : [this.state.awaited?.name, ...this.state.chosen].includes(pick.name) ? CHOSEN : PICK;
    for (const [style, width] of [['#000b', 4], [colour, 1.8]]) {
      context.strokeStyle = style;
      context.lineWidth = width;
      context.beginPath();
      context.arc(x, y, 6, 0, 2 * Math.PI);
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        context.moveTo(x + 3 * dx, y + 3 * dy);
        context.lineTo(x + 10 * dx, y + 10 * dy);
      }
      context.stroke();
    }
    this.text(context, pick.name, x + 11, y - 11, 'left', 13);
  }

  text(context, text, x, y, align, size) {
    context.font = `600 ${size}px system-ui, 'DejaVu Sans', sans-serif`;
    context.textAlign = align;
    context.textBaseline = 'middle';
    const width = context.measureText(text).width;
    const left = align === 'center' ? x - width / 2 : x;
    context.fillStyle = '#14161acc';
    context.beginPath();
    context.roundRect(left - 5, y - size / 2 - 4, width + 10, size + 8, 4);
    context.fill();
    context.fillStyle = '#fff';
    context.fillText(text, x, y + 1);
  }
}
