// Shows GLB files of cvn.export: one primitive, positions, (u, v) and a palette. Browsers give a
// page only some sixteen WebGL contexts, so one draws for all canvases, and each copies its picture.
'use strict';
const VERTEX = `#version 300 es
in vec3 position; in vec2 uv; uniform vec4 turn; uniform float distance;
out vec3 p; out vec2 t;
void main() {
  float ca = turn.x, sa = turn.y, ce = turn.z, se = turn.w;
  vec3 q = vec3(ca * position.x - sa * position.z, position.y, sa * position.x + ca * position.z);
  p = vec3(q.x, ce * q.y - se * q.z, se * q.y + ce * q.z - distance);
  t = uv;
  gl_Position = vec4(4.0 * p.xy, -1.105 * p.z - 1.053, -p.z);  // depths from 0.5 to 10
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 p; in vec2 t; uniform sampler2D palette; out vec4 color;
void main() {
  vec3 n = normalize(cross(dFdx(p), dFdy(p)));
  float light = 0.72 + 0.28 * max(0.0, dot(n, normalize(vec3(-0.45, 0.75, 0.5))));
  color = vec4(light * texture(palette, t).rgb, 1.0);
}`;

const gl = document.createElement('canvas').getContext('webgl2', {antialias: true});
const program = gl && link(gl.createProgram());
const groups = new Map();
let asked = 0, last = 0;

function link(program) {
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw gl.getProgramInfoLog(program);
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.CULL_FACE);
  return program;
}

async function read(name) {
  const text = atob(document.getElementById(name).textContent);
  const bytes = Uint8Array.from(text, (c) => c.charCodeAt(0));
  if (bytes[0] !== 0x1f) return bytes.buffer;  // not gzip
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Response(stream).arrayBuffer();
}

function parse(buffer) {
  const size = new DataView(buffer).getUint32(12, true);
  const tree = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, size)));
  const start = 28 + size;
  const view = (i) => {
    const v = tree.bufferViews[i], from = start + (v.byteOffset || 0);
    return buffer.slice(from, from + v.byteLength);
  };
  const primitive = tree.meshes[0].primitives[0];
  const accessor = (i) => view(tree.accessors[i].bufferView);
  const texture = tree.materials[primitive.material].pbrMetallicRoughness.baseColorTexture.index;
  const image = tree.images[tree.textures[texture].source];
  return {
    index: new Uint32Array(accessor(primitive.indices)),
    position: new Float32Array(accessor(primitive.attributes.POSITION)),
    uv: new Float32Array(accessor(primitive.attributes.TEXCOORD_0)),
    image: new Blob([view(image.bufferView)], {type: image.mimeType}),
  };
}

async function upload(name) {
  const model = parse(await read(name));
  const picture = await createImageBitmap(model.image, {colorSpaceConversion: 'none'});
  const array = gl.createVertexArray(), texture = gl.createTexture();
  gl.bindVertexArray(array);
  for (const [name, width] of [['position', 3], ['uv', 2]]) {
    const at = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, model[name], gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, width, gl.FLOAT, false, 0, 0);
  }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, model.index, gl.STATIC_DRAW);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  return {array, texture, count: model.index.length};
}

function draw({canvas, model}, {azimuth, elevation, distance}) {
  const {width, height} = canvas;
  if (gl.canvas.width !== width || gl.canvas.height !== height) {
    Object.assign(gl.canvas, {width, height});
  }
  const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
  gl.uniform4f(gl.getUniformLocation(program, 'turn'),
    Math.cos(a), Math.sin(a), Math.cos(e), Math.sin(e));
  gl.uniform1f(gl.getUniformLocation(program, 'distance'), distance);
  gl.viewport(0, 0, width, height);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.bindVertexArray(model.array);
  gl.bindTexture(gl.TEXTURE_2D, model.texture);
  gl.drawElements(gl.TRIANGLES, model.count, gl.UNSIGNED_INT, 0);
  const copy = canvas.getContext('2d');
  copy.clearRect(0, 0, width, height);
  copy.drawImage(gl.canvas, 0, 0);
}

function frame(time) {
  asked = 0;
  const step = Math.min(time - last, 50);
  last = time;
  for (const group of groups.values()) {
    const views = group.views.filter((v) => v.seen && v.model);
    if (group.turning) group.azimuth -= 0.02 * step;
    if (group.turning || group.changed) for (const view of views) draw(view, group);
    group.changed = false;
    if (group.turning && views.length) redraw();
  }
}

function redraw() { asked = asked || requestAnimationFrame(frame); }

function show(canvas) {
  if (!gl) {
    canvas.replaceWith('This browser has no WebGL 2.');
    return;
  }
  const name = canvas.dataset.group || canvas.dataset.glb;
  // Degrees, as in the panels, and units of the cube's side.
  const start = {azimuth: +canvas.dataset.azimuth, elevation: 20, distance: 3.5, views: [],
    turning: !matchMedia('(prefers-reduced-motion: reduce)').matches};
  if (!groups.has(name)) groups.set(name, start);
  const group = groups.get(name), view = {canvas, seen: false, model: null};
  group.views.push(view);
  const change = (azimuth, elevation, zoom) => {
    group.azimuth -= azimuth;
    group.elevation = Math.max(-90, Math.min(90, group.elevation + elevation));
    group.distance = Math.max(1.5, Math.min(8, group.distance * zoom));
    group.turning = false;
    group.changed = true;
    redraw();
  };
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    change(0, 0, 1);
  });
  canvas.addEventListener('pointermove', (event) => {
    if (event.buttons) change(0.6 * event.movementX, 0.6 * event.movementY, 1);
  });
  canvas.addEventListener('wheel', (event) => {
    if (group.turning) return;  // not taken hold of: the page scrolls
    event.preventDefault();
    change(0, 0, Math.exp(0.001 * event.deltaY));
  }, {passive: false});
  canvas.addEventListener('keydown', (event) => {
    const turns = {ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, -10], ArrowDown: [0, 10]};
    if (!(event.key in turns)) return;
    event.preventDefault();
    change(...turns[event.key], 1);
  });
  new IntersectionObserver(async (entries) => {
    view.seen = entries[entries.length - 1].isIntersecting;
    if (!view.seen) return;
    view.loading = view.loading || upload(canvas.dataset.glb);
    view.model = await view.loading;
    group.changed = true;
    redraw();
  }).observe(canvas);
}

for (const canvas of document.querySelectorAll('canvas.viewer')) show(canvas);
