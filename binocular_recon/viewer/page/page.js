// SPDX-License-Identifier: Apache-2.0
// The page: asks the server for everything, and shows the state that comes back. All pages that
// are open show the same; only zoom and the view of the cloud are a page's own.

import {ImagePane} from './image_pane.js';

const $ = (id) => document.getElementById(id);
const MESSAGE_MS = 12000, AGAIN_MS = 1000;
let state = null, socket = null, waiting = new Map(), lastId = 0, messageTimer = null;

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function say(text) {
  $('message').textContent = text;
  $('message').hidden = !text;
  clearTimeout(messageTimer);
  if (text) messageTimer = setTimeout(() => say(''), MESSAGE_MS);
}

// the connection

function connect() {
  const address = new URL('session', location.href);
  address.protocol = 'ws:';
  socket = new WebSocket(address);
  socket.onmessage = ({data}) => {
    const message = JSON.parse(data);
    if (message.state) {
      if (!state || message.state.revision >= state.revision) show(message.state);
    } else if (message.problem) say(message.problem);
    else {
      waiting.get(message.id)?.(message);
      waiting.delete(message.id);
    }
  };
  socket.onclose = () => {
    waiting.clear();
    state = null;
    $('saved').textContent = 'view has ended, or cannot be reached; all picks were saved';
    $('saved').className = 'problem';
    setTimeout(connect, AGAIN_MS);
  };
}

function ask(what, fields = {}) {
  return new Promise((resolve) => {
    if (socket.readyState !== WebSocket.OPEN) return;
    lastId += 1;
    waiting.set(lastId, resolve);
    socket.send(JSON.stringify({do: what, id: lastId, ...fields}));
  });
}

async function act(what, fields = {}) {
  const {error} = await ask(what, fields);
  say(error ?? '');
  if (error && state) show(state); // what was typed goes back to what is
}

// the image

let probing = false, wanted = null;

async function probe(at) {
  wanted = at;
  if (probing) return;
  probing = true;
  while (wanted) {
    const {u, v} = wanted;
    wanted = null;
    const {done, error} = await ask('probe', {u, v});
    if (hovered && !hovered.pick) {
      const problem = error ?? done.problem;
      reading(u, v, problem ? problem.replace(/^.* is on/, 'on') : done.text, problem);
    }
  }
  probing = false;
}

function reading(u, v, text, problem) {
  $('pixel').textContent = `${u.toFixed(1)}, ${v.toFixed(1)} px   ${text}`;
  $('pixel').className = problem ? 'problem' : '';
}

let hovered = null, inBoth = false;
const pane = new ImagePane($('image'), {
  click: (u, v) => act('click', {u, v, both: inBoth}),
  take: (name) => act('take', {name}),
  hover(at) {
    hovered = at;
    $('tip').hidden = !at?.pick;
    point(at?.pick?.name ?? null);
    if (!at || !state) { $('pixel').textContent = ''; return; }
    const [width, height] = state.shown.size;
    if (at.pick) {
      $('tip').textContent = `${at.pick.name}\n${lines(at.pick)}`;
      $('tip').style.left = `${Math.min(at.x + 14, $('left').clientWidth - 230)}px`;
      $('tip').style.top = `${at.y + 14}px`;
    } else if (at.u >= 0 && at.v >= 0 && at.u <= width - 1 && at.v <= height - 1) probe(at);
    else $('pixel').textContent = '';
  },
});

const rightPane = new ImagePane($('right-image'), {
  click: (u, v) => act('click_right', {u, v}),
  take: (name) => act('await_right', {name}),
  hover(at) {
    point(at?.pick?.name ?? null);
    $('pixel').textContent = at && state ? `right image ${at.u.toFixed(1)}, ${at.v.toFixed(1)} px` : '';
    $('pixel').className = '';
  },
}, 'right');

function showRight(wanted) {
  inBoth = wanted;
  $('right-image').hidden = !inBoth;
  $('both').setAttribute('aria-pressed', inBoth);
  if (state) show(state);
}

const lines = (one) => one.problem
  ?? one.quantities.map(({what, text}) => `${what} ${text}`).join('\n');

function point(name) {
  for (const one of [pane, rightPane]) {
    one.hot = name;
    one.draw();
  }
  for (const row of document.querySelectorAll('li')) {
    row.classList.toggle('hot', row.dataset.name === name);
  }
}

// what is shown

function show(next) {
  const first = !state;
  state = next;
  const {shown} = state;
  pane.show(state);
  rightPane.show(state);
  $('both').hidden = !shown.right;
  if (inBoth && !shown.right) showRight(false);
  if (first && !$('cloud').src) $('cloud').src = 'cloud/';
  document.title = `${state.folder.split('/').at(-1)} – binocular-recon view`;
  $('folder').textContent = state.folder.split('/').at(-1);
  $('folder').title = state.folder;
  $('frames').hidden = state.frames < 2;
  $('frame').max = state.frames - 1;
  $('frame').value = shown.frame;
  $('of').textContent = `of ${state.frames}`;
  $('previous').disabled = shown.frame === 0;
  $('next').disabled = shown.frame === state.frames - 1;
  $('undo').disabled = !state.can_undo;
  $('redo').disabled = !state.can_redo;
  const [nearest, farthest] = shown.depth_m ?? [0, 0];
  $('near').value = (shown.near_m || nearest).toFixed(1);
  $('far').value = (shown.far_m ?? farthest).toFixed(1);
  $('all').disabled = !shown.near_m && shown.far_m === null;
  const file = state.file.split('/').at(-1);
  $('saved').className = '';
  $('saved').title = state.file;
  $('saved').textContent = state.keeps_measurements ? `saved in ${file}`
    : `points saved in ${file}; measurements need a .yaml file`;
  radio($('colours'), state.colours, shown.colour, (colour) => act('show', {colour}));
  legend(shown.legend);
  const number = (value) => value.toLocaleString('en').replaceAll(',', '\u202f');
  $('points').textContent = shown.step === 1 ? `all ${number(shown.points_of)} points`
    : `${number(shown.points)} of ${number(shown.points_of)} points shown; measuring uses every pixel`;
  const names = Object.fromEntries(Object.keys(state.kinds).map((kind) => [kind, kind]));
  radio($('kinds'), names, state.kind, (kind) => act('kind', {kind}));
  for (const button of $('kinds').children) button.title = state.kinds[button.dataset.name].text;
  hint();
  $('measurements').replaceChildren(...state.measurements.map(measurementRow));
  pickRows();
  $('sigma').textContent = `Sigma holds pick noise and ${state.sigma}.`;
}

function radio(box, options, chosen, choose) {
  if (!box.children.length) {
    for (const [name, text] of Object.entries(options)) {
      const button = element('button', {textContent: text, onclick: () => choose(name)});
      button.dataset.name = name;
      button.setAttribute('role', 'radio');
      box.append(button);
    }
  }
  for (const button of box.children) {
    button.setAttribute('aria-checked', button.dataset.name === chosen);
  }
}

function hint() {
  const {least, most, text} = state.kinds[state.kind];
  const count = state.chosen.length;
  const points = (number) => `${number} point${number === 1 ? '' : 's'}`;
  const needed = most ? points(most) : `${points(least)} or more`;
  const left = most ? `${most - count} more`
    : count < least ? `${least - count} or more to come` : 'Enter or Finish ends it';
  $('hint').textContent = `${text[0].toUpperCase()}${text.slice(1)}. `
    + (count ? `${state.chosen.join(', ')}: ${left}.` : `Click ${needed} in the image or the cloud.`);
  if (state.awaited) {
    $('hint').textContent = `${state.awaited.name}: click the same point in the right image, on the line.`;
  }
  $('making').hidden = !count && !state.awaited;
  $('finish').hidden = most !== 0 || !count;
  $('finish').disabled = count < least;
}

function legend({title, low, high, colours, entries}) {
  const parts = [];
  if (low) {
    const bar = element('div', {className: 'bar'});
    bar.style.background = `linear-gradient(to right, ${colours.join(', ')})`;
    parts.push(title, bar, element('div', {className: 'ends'},
      element('span', {textContent: low}), element('span', {textContent: high})));
  } else {
    entries.forEach((entry, index) => {
      const patch = element('i');
      patch.style.background = colours[index];
      parts.push(element('div', {}, patch, entry));
    });
  }
  $('legend').replaceChildren(...parts);
}

function row(name, remove, ...children) {
  const button = element('button', {className: 'delete', textContent: '✕', onclick: remove});
  button.setAttribute('aria-label', `Delete ${name}`);
  const made = element('li', {}, ...children, button);
  made.dataset.name = name;
  made.onmouseenter = () => point(name);
  made.onmouseleave = () => point(null);
  return made;
}

function measurementRow(one, number) {
  const parts = [element('div', {className: 'name', textContent: one.name})];
  if (one.problem) parts.push(element('div', {className: 'problem', textContent: one.problem}));
  else {
    const shown = one.kind === 'point' ? one.quantities : one.quantities.slice(0, 1);
    for (const {what, text, from} of shown) {
      parts.push(element('div', {
        className: 'value', title: from ? `sigma mostly from ${from}` : '',
        textContent: shown.length > 1 ? `${what} ${text}` : text,
      }));
    }
    for (const {what, text} of one.quantities.slice(shown.length)) {
      parts.push(element('div', {className: 'more', textContent: `${what} ${text}`}));
    }
  }
  const made = row(one.name, () => act('delete_measurement', {number}), ...parts);
  made.lastChild.title = 'Delete it and the points that only it uses';
  if (one.frame !== undefined && one.frame !== state.shown.frame) {
    parts[0].textContent += ` (frame ${one.frame})`;
    made.ondblclick = () => act('show', {frame: one.frame});
    made.title = 'Double-click to see it';
  }
  return made;
}

function pickRows() {
  const edited = document.activeElement?.matches('#picks input') ? document.activeElement : null;
  if (edited && state.picks.some(({name}) => name === edited.defaultValue)) {
    edited.dispatchEvent(new Event('change')); // someone else's change came while typing
    edited.blur();
  }
  $('picks').replaceChildren(...state.picks.map((pick) => {
    const {name} = pick;
    const input = element('input', {className: 'name', defaultValue: name, value: name, title: 'Rename'});
    input.setAttribute('aria-label', `Name of ${name}`);
    input.onchange = () => input.value !== name && act('rename', {name, to: input.value});
    input.onkeydown = (event) => {
      if (event.key === 'Enter') input.blur();
      if (event.key === 'Escape') { input.value = name; input.blur(); }
    };
    const px = (pixel) => `${pixel[0].toFixed(1)}, ${pixel[1].toFixed(1)} px`;
    const place = `frame ${pick.frame}: ${px(pick.left)}${pick.right ? `, right ${px(pick.right)}` : ''}`;
    const both = element('button', {
      className: 'both', textContent: 'in the right image',
      onclick: () => act('await_right', {name}),
    });
    const made = row(name, () => act('delete_pick', {name}), input,
      element('div', {className: 'more', textContent: place}),
      ...(inBoth && pick.frame === state.shown.frame ? [both] : []),
      ...(pick.problem ? [element('div', {className: 'problem', textContent: pick.problem})]
        : pick.quantities.map(({what, text}) => element('div', {className: 'more', textContent: `${what} ${text}`}))));
    made.lastChild.title = 'Delete it and all that is measured with it';
    return made;
  }));
}

// controls

const fit = () => [pane, rightPane].forEach((one) => one.fit());
const frame = (number) => act('show', {frame: Number(number)});
$('previous').onclick = () => frame(state.shown.frame - 1);
$('next').onclick = () => frame(state.shown.frame + 1);
$('frame').onchange = () => frame($('frame').value);
$('near').onchange = () => act('show', {near_m: $('near').value || null});
$('far').onchange = () => act('show', {far_m: $('far').value || null});
$('all').onclick = () => act('show', {near_m: null, far_m: null});
$('undo').onclick = () => act('undo');
$('redo').onclick = () => act('redo');
$('finish').onclick = () => act('finish');
$('cancel').onclick = () => act('cancel');
$('fit').onclick = fit;
$('both').onclick = () => showRight(!inBoth);
$('message').onclick = () => say('');
$('measurements').dataset.empty = 'None yet.';
$('picks').dataset.empty = 'None yet.';

function pressed(event) {
  if (event.target.matches('input') || !state) return;
  const key = event.key.toLowerCase();
  const control = event.ctrlKey || event.metaKey;
  if (control && key === 'z') act(event.shiftKey ? 'redo' : 'undo');
  else if (control && key === 'y') act('redo');
  else if (control || event.altKey) return;
  else if (key === 'enter' && !event.target.matches('button')) {
    if (!$('finish').hidden && !$('making').hidden) act('finish');
  } else if (key === 'escape') act('cancel');
  else if (key === 'f') fit();
  else if (key === 'pageup' && state.shown.frame > 0) frame(state.shown.frame - 1);
  else if (key === 'pagedown' && state.shown.frame < state.frames - 1) frame(state.shown.frame + 1);
  else return;
  event.preventDefault();
}
document.addEventListener('keydown', pressed);
$('cloud').onload = () => $('cloud').contentDocument.addEventListener('keydown', pressed);

$('splitter').onpointerdown = (event) => $('splitter').setPointerCapture(event.pointerId);
$('splitter').onpointermove = (event) => {
  if (!$('splitter').hasPointerCapture(event.pointerId)) return;
  const room = $('left').clientWidth + $('right').clientWidth;
  const share = Math.min(0.9, Math.max(0.1, event.clientX / room));
  $('left').style.flexGrow = share;
  $('right').style.flexGrow = 1 - share;
};

connect();
