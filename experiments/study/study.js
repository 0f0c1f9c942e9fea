// What the user study's page does; its content stands in the page as JSON.
'use strict';
const study = JSON.parse(document.getElementById('content').textContent);
const element = (id) => document.getElementById(id);
const SECONDS_A_TURN = 8, PAUSE = 250;  // ms that a choice is shown before the next pair
const SIDES = ['left', 'right'];

// ---- What is remembered: state = {subject, seed, started, finished, at, answers: {pair: answer}}
const KEY = 'user study ' + study.page;
function load() {
  try { return JSON.parse(localStorage.getItem(KEY)); } catch { return null; }
}
function keep() {
  try { localStorage.setItem(KEY, JSON.stringify(state)); } catch { /* a reload loses them */ }
}
function forget() {
  try { localStorage.removeItem(KEY); } catch { /* nothing was kept */ }
  location.reload();
}
const randomWord = () => crypto.getRandomValues(new Uint32Array(1))[0];

// ---- Order and sides: the same for the same seed.
function generator(seed) {  // mulberry32: numbers in [0, 1)
  return () => {
    seed = (seed + 0x6D2B79F5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}
function plan(seed) {
  const random = generator(seed);
  const shuffled = (list) => {
    const result = [...list];
    for (let i = result.length - 1; i > 0; --i) {
      const j = Math.floor(random() * (i + 1));
      [result[i], result[j]] = [result[j], result[i]];
    }
    return result;
  };
  // A picture twice in a row would show which of the models has just been there.
  const repeats = (list) => list.some((p, i) => i > 0 && p.picture === list[i - 1].picture);
  let order = shuffled(study.pairs);
  for (let tries = 0; tries < 1000 && repeats(order); ++tries) order = shuffled(study.pairs);
  return order.map((pair) => {
    const [left, right] = random() < 0.5 ? pair.sheets : [...pair.sheets].reverse();
    return {pair: pair.name, picture: pair.picture, left, right};
  });
}

// ---- Turntables. Both models always show the same side.
const sheets = new Map();  // the pairs around the one shown, no more: decoded sheets are large
function sheet(name) {
  if (!sheets.has(name)) {
    const image = new Image();
    image.src = 'data:image/webp;base64,' + study.sheets[name].image;
    sheets.set(name, image.decode().then(() => image));
  }
  return sheets.get(name);
}
let shown = [], position = 0, turning = false, last = 0, drawn = -1;
function drawFrame(canvas, {name, image}, frame) {
  const {width, height} = study.sheets[name];
  canvas.width = width;
  canvas.height = height;
  const x = width * (frame % study.columns), y = height * Math.floor(frame / study.columns);
  canvas.getContext('2d').drawImage(image, x, y, width, height, 0, 0, width, height);
}
function turn(frames) {
  position = ((position + frames) % study.frames + study.frames) % study.frames;
}
function animate(time) {
  if (turning) turn(study.frames * Math.min(time - last, 100) / 1000 / SECONDS_A_TURN);
  last = time;
  const frame = Math.floor(position);
  if (shown.length && frame !== drawn) {
    drawn = frame;
    SIDES.forEach((side, i) => {
      drawFrame(element(side).querySelector('.turntable'), shown[i], frame);
      const nearest = Math.round(4 * frame / study.frames) % 4;
      element(side).querySelectorAll('.sides canvas').forEach(
        (canvas, n) => canvas.classList.toggle('now', n === nearest));
    });
  }
  requestAnimationFrame(animate);
}

// ---- Pages
let state = load(), trials = [], since = 0, busy = true;
function open(id) {
  for (const name of ['start', 'pair', 'end']) element(name).hidden = name !== id;
  element('reset').hidden = id !== 'pair';
  element('who').textContent = state ? `You are ${state.subject}.` : '';
  window.scrollTo(0, 0);
}
async function show() {
  busy = true;
  if (state.at === trials.length) {
    open('end');
    element('save').focus();
    busy = false;
    return;
  }
  const trial = trials[state.at], soon = trials[state.at + 1];
  const wanted = [trial, soon ?? trial].flatMap((t) => [t.left, t.right]);
  for (const name of sheets.keys()) if (!wanted.includes(name)) sheets.delete(name);
  wanted.forEach(sheet);
  const names = [trial.left, trial.right];
  shown = (await Promise.all(names.map(sheet))).map((image, i) => ({name: names[i], image}));
  open('pair');
  element('picture').src = 'data:image/png;base64,' + study.pictures[trial.picture];
  const earlier = state.answers[trial.pair];
  SIDES.forEach((side, i) => {
    element(side).className = earlier && earlier.choice === trial[side] ? 'earlier' : '';
    element(side).querySelectorAll('.sides canvas').forEach(
      (canvas, n) => drawFrame(canvas, shown[i], Math.round(n * study.frames / 4)));
  });
  element('progress').textContent = `${state.at + 1} of ${trials.length}`;
  element('bar').setAttribute('aria-valuemax', trials.length);
  element('bar').setAttribute('aria-valuenow', state.at);
  element('bar').firstChild.style.width = `${100 * state.at / trials.length}%`;
  element('back').disabled = state.at === 0;
  element('question').focus();
  position = 0;
  drawn = -1;
  turning = !matchMedia('(prefers-reduced-motion: reduce)').matches;
  since = performance.now();
  busy = false;
}
function choose(side) {
  if (busy || element('pair').hidden) return;
  busy = true;
  const {pair, left, right, [side]: choice} = trials[state.at];
  const before = state.answers[pair] ? state.answers[pair].milliseconds : 0;
  const milliseconds = Math.round(before + performance.now() - since);
  state.answers[pair] = {pair, left, right, choice, milliseconds};
  ++state.at;
  if (state.at === trials.length) state.finished = new Date().toISOString();
  keep();
  for (const s of SIDES) element(s).className = s === side ? 'chosen' : '';
  setTimeout(show, PAUSE);
}
function back() {
  if (busy || state.at === 0) return;
  --state.at;
  keep();
  show();
}
function save() {
  const {subject, seed, started, finished} = state;
  const answers = trials.map((t) => state.answers[t.pair]);
  const {page, format} = study;
  const text = JSON.stringify({format, page, subject, seed, started, finished, answers}, null, 1);
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([text + '\n'], {type: 'application/json'}));
  link.download = `answers_${page}_${subject}.json`;
  link.click();
  element('saved').textContent =
    `Saved as ${link.download} where this browser keeps its downloads.`;
  element('next').hidden = false;
}

// ---- Clicks, keys, drags
element('form').addEventListener('submit', (event) => {
  event.preventDefault();
  const started = new Date().toISOString();
  state = {subject: element('subject').value, seed: randomWord(), started, at: 0, answers: {}};
  trials = plan(state.seed);
  keep();
  show();
});
element('back').addEventListener('click', back);
element('again').addEventListener('click', back);
element('save').addEventListener('click', save);
element('next').addEventListener('click', forget);
element('reset').addEventListener('click', () => {
  if (confirm('Start over? All answers given so far are lost.')) forget();
});
for (const side of SIDES) {
  element(side).querySelector('button').addEventListener('click', () => choose(side));
  const canvas = element(side).querySelector('.turntable');
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    turning = false;
  });
  canvas.addEventListener('pointermove', (event) => {
    if (event.buttons) turn(-study.frames * event.movementX / canvas.clientWidth);
  });
  for (let n = 0; n < 4; ++n) {
    const small = element(side).querySelector('.sides').appendChild(
      document.createElement('canvas'));
    small.addEventListener('click', () => {
      turning = false;
      position = Math.round(n * study.frames / 4);
    });
  }
}
document.addEventListener('keydown', (event) => {
  if (element('pair').hidden || event.ctrlKey || event.altKey || event.metaKey) return;
  const onButton = event.target instanceof HTMLButtonElement;
  const actions = {
    ArrowLeft: () => event.repeat || choose('left'),
    ArrowRight: () => event.repeat || choose('right'),
    ArrowUp: () => { turning = false; turn(1); },
    ArrowDown: () => { turning = false; turn(-1); },
    Backspace: () => event.repeat || back(),
    ...(onButton ? {} : {' ': () => { if (!event.repeat) turning = !turning; }}),
  };
  if (!(event.key in actions)) return;
  event.preventDefault();
  actions[event.key]();
});

requestAnimationFrame(animate);
if (state) {
  trials = plan(state.seed);
  show();
} else {
  element('subject').value = 'S' + randomWord().toString(16).padStart(8, '0').slice(0, 6);
  open('start');
  element('subject').focus();
}
