// The solid in 3-D, by WebGL 2 alone. k3d was tried first: it carries 2.5 MB with 60 fonts of its own, asks for fonts and
// a worker from elsewhere, evaluates text as code, and drew nothing where the page's policy forbids all that.

const facts = JSON.parse(document.getElementById("view-facts").textContent);
const axisNumber = () => ["x", "y", "z"].indexOf(part("axis").value);
const part = (name) => document.getElementById(`view-${name}`);
const canvas = part("canvas");
const isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;

const VERTEX = `#version 300 es
in vec3 place; in vec3 normal; in float thickness;
uniform mat3 turn; uniform vec3 focus; uniform vec2 zoom; uniform float depth, back, size;
out vec3 at, facing, seen; out float thick;
void main() {
  at = place; facing = turn * normal; thick = thickness; seen = turn * (place - focus);
  gl_Position = vec4(seen.xy * zoom, back - seen.z * depth, 1.0);
  gl_PointSize = size;
}`;
const HEAD = `#version 300 es
precision highp float;
in vec3 at, facing, seen; in float thick;
uniform vec4 cut; uniform vec3 colour; uniform float alpha;
out vec4 shown;
`;
const SURFACE = `${HEAD}
uniform vec3 ramp[9], cap; uniform bool byThickness;
void main() {
  if (dot(at, cut.xyz) > cut.w) discard;
  vec3 flatly = normalize(cross(dFdx(seen), dFdy(seen))), n = normalize(facing);
  if (!gl_FrontFacing) { shown = vec4(cap, 1.0); return; }
  if (dot(n, flatly) < 0.7) n = flatly;
  float shade = clamp(thick, 0.0, 1.0) * 8.0; int low = min(int(shade), 7);
  vec3 own = byThickness ? mix(ramp[low], ramp[low + 1], shade - float(low)) : colour;
  float key = max(dot(n, normalize(vec3(-0.5, 0.75, 1.0))), 0.0), fill = max(dot(n, normalize(vec3(0.9, 0.1, 0.5))), 0.0);
  float far = mix(0.5, 1.0, smoothstep(-0.5, 0.15, seen.z));
  shown = vec4(own * (0.42 + 0.66 * key + 0.18 * fill) * far + 0.06 * pow(key, 24.0), 1.0);
}`;
const GLASS = `${HEAD}
void main() {
  float edge = 1.0 - abs(normalize(facing).z);
  float a = alpha * (0.1 + 0.75 * edge * edge * edge);
  shown = vec4(colour * a, a);
}`;
const MARK = `${HEAD}
uniform bool isHidden;
void main() {
  if (dot(at, cut.xyz) > cut.w) discard;
  float r = length(gl_PointCoord - 0.5) * 2.0;
  if (r > 1.0) discard;
  float a = isHidden ? 0.3 : 1.0;
  shown = vec4((r > 0.72 && !isHidden ? vec3(1.0) : colour) * a, a);
}`;

// What the page holds: numbers without loss of order, packed

async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  let start = 0;
  const take = (Kind, count) => new Kind(buffer, (start += count * Kind.BYTES_PER_ELEMENT) - count * Kind.BYTES_PER_ELEMENT, count);
  const [faces, outerFaces] = [take(Uint32Array, 3 * facts.faces), take(Uint32Array, 3 * facts.outerFaces)];
  const [places, outerPlaces] = [take(Uint16Array, 3 * facts.vertices), take(Uint16Array, 3 * facts.outerVertices)];
  return { faces, outerFaces, places, outerPlaces, thickness: take(Uint8Array, facts.thickness ? facts.vertices : 0) };
}

// A normal at each vertex, the mean of its triangles' by their areas, as signed bytes.
function normalsOf(places, faces) {
  const sums = new Float32Array(places.length);
  for (let i = 0; i < faces.length; i += 3) {
    const [a, b, c] = [3 * faces[i], 3 * faces[i + 1], 3 * faces[i + 2]];
    const [ux, uy, uz] = [places[b] - places[a], places[b + 1] - places[a + 1], places[b + 2] - places[a + 2]];
    const [vx, vy, vz] = [places[c] - places[a], places[c + 1] - places[a + 1], places[c + 2] - places[a + 2]];
    const [nx, ny, nz] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const at of [a, b, c]) { sums[at] += nx; sums[at + 1] += ny; sums[at + 2] += nz; }
  }
  const normals = new Int8Array((places.length / 3) * 4);
  for (let i = 0, j = 0; i < sums.length; i += 3, j += 4) {
    const length = Math.hypot(sums[i], sums[i + 1], sums[i + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[j + k] = Math.round((127 * sums[i + k]) / length);
  }
  return normals;
}

// Programs and buffers

function makeProgram(gl, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  ["place", "normal", "thickness"].forEach((name, index) => gl.bindAttribLocation(program, index, name));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  const known = new Map();
  const at = (name) => known.get(name) ?? known.set(name, gl.getUniformLocation(program, name)).get(name);
  return { program, at };
}

function makeShape(gl, { places, normals, thickness, faces }) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  const attribute = (index, values, count, type, stride) => {
    if (!values?.length) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, count, type, type !== gl.FLOAT, stride, 0);
  };
  attribute(0, places, 3, places instanceof Float32Array ? gl.FLOAT : gl.UNSIGNED_SHORT, 0);
  attribute(1, normals, 3, gl.BYTE, 4);
  attribute(2, thickness, 1, gl.UNSIGNED_BYTE, 0);
  if (faces) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  }
  gl.bindVertexArray(null);
  return { array, count: faces?.length ?? places.length / 3 };
}

// Where the reader looks from: an aim, and what is shown on its way there

const unit = facts.scale; // mm to which 1 in the packed places comes
const middle = facts.size.map((length) => length / unit / 2);
const start = {
  turn: facts.size[0] >= facts.size[1] ? Math.atan2(-0.75, 0.55) : Math.atan2(-0.55, 0.75), rise: 0.38, zoom: 1,
  x: middle[0], y: middle[1], z: middle[2],
};
const aim = { ...start };
const view = { ...start };
let isAsked = false;

function ask() {
  if (isAsked) return;
  isAsked = true;
  requestAnimationFrame(() => { isAsked = false; frame(); });
}

function approach() {
  let isThere = true;
  for (const key of Object.keys(aim)) {
    const rest = aim[key] - view[key];
    view[key] = isCalm || Math.abs(rest) < 1e-4 ? aim[key] : view[key] + 0.3 * rest;
    isThere &&= view[key] === aim[key];
  }
  if (!isThere) ask();
}

function axesOf({ turn, rise }) {
  const [c, s, C, S] = [Math.cos(turn), Math.sin(turn), Math.cos(rise), Math.sin(rise)];
  return { right: [-s, c, 0], up: [-S * c, -S * s, C], eye: [C * c, C * s, S] };
}

// Pixels that a packed unit takes: at a zoom of 1 the shape fits in, turned whichever way.
function zoomOf(width, height) {
  return (view.zoom * 0.98 * Math.min(width, height) * unit) / Math.hypot(...facts.size);
}

// Starts where the solid and the outer shape, as they are seen at first, just fit in.
function fitIn(...clouds) {
  const axes = axesOf(start);
  const [across, upward] = [axes.right, axes.up].map(([x, y, z]) => {
    let [low, high] = [Infinity, -Infinity];
    for (const places of clouds) for (let i = 0; i < places.length; i += 3) {
      const along = (x * places[i] + y * places[i + 1] + z * places[i + 2]) / 65535;
      if (along < low) low = along;
      if (along > high) high = along;
    }
    return { middle: (low + high) / 2, length: high - low || 1 };
  });
  const depth = axes.eye.reduce((sum, part, k) => sum + part * middle[k], 0);
  ["x", "y", "z"].forEach((key, k) => {
    start[key] = across.middle * axes.right[k] + upward.middle * axes.up[k] + depth * axes.eye[k];
  });
  const { clientWidth: width, clientHeight: height } = canvas;
  start.zoom = 0.88 * Math.min(width / across.length, height / upward.length) / zoomOf(width, height);
  Object.assign(view, start);
  Object.assign(aim, start);
}

let draw = () => {};
function frame() {
  approach();
  const scale = Math.min(devicePixelRatio, 2);
  const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
  if (!width || !height) return;
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const pixels = zoomOf(width, height);
  draw(width, height, pixels, scale);
  showBar(pixels / scale / unit);
}

function showBar(pixelsPerMm) {
  const most = 160 / pixelsPerMm;
  const power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((factor) => factor * power).find((size) => size <= most * (1 + 1e-9));
  part("bar").style.width = `${length * pixelsPerMm}px`;
  part("bar").textContent = `${Number(length.toPrecision(3))} mm`;
}

// Pictures

function cutPlane() {
  const axis = axisNumber();
  const slider = part("cut");
  if (axis < 0) return [0, 0, 0, 1];
  const sign = part("flip").checked ? -1 : 1;
  const place = (Number(slider.value) - facts.low[axis]) / unit;
  return [0, 1, 2].map((each) => (each === axis ? sign : 0)).concat(sign * place);
}

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

function makePainter(gl, packed) {
  const [surface, glass, mark] = [SURFACE, GLASS, MARK].map((fragment) => makeProgram(gl, fragment));
  const solid = makeShape(gl, { ...packed, normals: normalsOf(packed.places, packed.faces) });
  const outer = facts.outerFaces && makeShape(gl, {
    places: packed.outerPlaces, normals: normalsOf(packed.outerPlaces, packed.outerFaces), faces: packed.outerFaces });
  const marks = facts.findings.map(({ places }) => makeShape(gl, {
    places: new Float32Array(places.flatMap((place) => place.map((length, k) => (length - facts.low[k]) / unit))) }));
  gl.enable(gl.DEPTH_TEST);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  gl.cullFace(gl.BACK);

  function use({ program, at }, camera, back = 0, size = 1) {
    gl.useProgram(program);
    const { right, up, eye } = camera.axes;
    gl.uniformMatrix3fv(at("turn"), false, [0, 1, 2].flatMap((k) => [right[k], up[k], eye[k]]));
    gl.uniform3f(at("focus"), view.x, view.y, view.z);
    gl.uniform2f(at("zoom"), (2 * camera.pixels) / camera.width, (2 * camera.pixels) / camera.height);
    gl.uniform1f(at("depth"), 0.45);
    gl.uniform1f(at("back"), back);
    gl.uniform1f(at("size"), size);
    return at;
  }

  function paint({ array, count }, how) {
    gl.bindVertexArray(array);
    how === gl.POINTS ? gl.drawArrays(how, 0, count) : gl.drawElements(how, count, gl.UNSIGNED_INT, 0);
  }

  function paintSolid(camera) {
    const at = use(surface, camera);
    const isByThickness = part("colour")?.value === "thickness";
    gl.uniform4fv(at("cut"), cutPlane());
    gl.uniform3fv(at("colour"), rgb(facts.bone));
    gl.uniform3fv(at("cap"), rgb(isByThickness ? "#8b8f96" : facts.cap));
    gl.uniform3fv(at("ramp"), facts.ramp.flatMap(rgb));
    gl.uniform1i(at("byThickness"), isByThickness);
    paint(solid, gl.TRIANGLES);
  }

  function paintMarks(camera, scale) {
    facts.findings.forEach((finding, index) => {
      if (!part(`finding-${index}`)?.checked || !finding.places.length) return;
      const at = use(mark, camera, -0.012, 13 * scale);
      gl.uniform3fv(at("colour"), rgb(finding.colour));
      gl.uniform4fv(at("cut"), cutPlane());
      for (const isHidden of [true, false]) {
        gl[isHidden ? "disable" : "enable"](gl.DEPTH_TEST);
        gl.uniform1i(at("isHidden"), isHidden);
        paint(marks[index], gl.POINTS);
      }
    });
  }

  return (width, height, pixels, scale) => {
    const camera = { width, height, pixels, axes: axesOf(view) };
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.disable(gl.BLEND);
    paintSolid(camera);
    gl.enable(gl.BLEND);
    if (outer && part("outer").checked) {
      const at = use(glass, camera, 0.01);
      gl.uniform3fv(at("colour"), rgb(facts.glass));
      gl.uniform1f(at("alpha"), 0.8);
      gl.enable(gl.CULL_FACE);
      gl.depthMask(false);
      paint(outer, gl.TRIANGLES);
      gl.depthMask(true);
      gl.disable(gl.CULL_FACE);
    }
    paintMarks(camera, scale);
  };
}

// What the reader does

const least = 0.4;
const most = 60;
const bounded = (value, low, high) => Math.min(high, Math.max(low, value));

function turnBy(turn, rise) {
  aim.turn += turn;
  aim.rise = bounded(aim.rise + rise, -Math.PI / 2, Math.PI / 2);
  ask();
}

function zoomBy(factor) {
  aim.zoom = bounded(aim.zoom * factor, least, most);
  ask();
}

function moveBy(right, up) {
  const axes = axesOf(view);
  const scale = 1 / zoomOf(canvas.clientWidth, canvas.clientHeight);
  ["x", "y", "z"].forEach((key, k) => (aim[key] -= scale * (right * axes.right[k] + up * axes.up[k])));
  ask();
}

function lookAt(place) {
  ["x", "y", "z"].forEach((key, k) => (aim[key] = (place[k] - facts.low[k]) / unit));
  aim.zoom = Math.max(aim.zoom, 5);
  ask();
}

function reset() {
  Object.assign(aim, start, { turn: start.turn + Math.round((view.turn - start.turn) / (2 * Math.PI)) * 2 * Math.PI });
  ask();
}

const KEYS = {
  ArrowLeft: () => turnBy(-0.12, 0), ArrowRight: () => turnBy(0.12, 0),
  ArrowUp: () => turnBy(0, -0.12), ArrowDown: () => turnBy(0, 0.12),
  "+": () => zoomBy(1.2), "=": () => zoomBy(1.2), "-": () => zoomBy(1 / 1.2), Home: reset,
};
const MOVES = {
  ArrowLeft: () => moveBy(-30, 0), ArrowRight: () => moveBy(30, 0),
  ArrowUp: () => moveBy(0, 30), ArrowDown: () => moveBy(0, -30),
};

function listen() {
  const fingers = new Map();
  const spread = () => { const [a, b] = fingers.values(); return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const before = fingers.size === 2 ? spread() : 0;
    const [right, up] = [event.clientX - finger.x, finger.y - event.clientY];
    [finger.x, finger.y] = [event.clientX, event.clientY];
    if (fingers.size === 2) zoomBy(spread() / before || 1);
    else if (event.shiftKey || event.buttons & 6) moveBy(right, up);
    else turnBy(-0.008 * right, -0.008 * up);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)));
  }, { passive: false });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("keydown", (event) => {
    const act = event.ctrlKey || event.metaKey || event.altKey ? null : ((event.shiftKey && MOVES[event.key]) || KEYS[event.key]);
    if (!act) return;
    event.preventDefault();
    act();
  });
}

function showControls() {
  const axis = axisNumber();
  part("plane").hidden = axis < 0;
  if (axis >= 0) part("place").textContent = `${part("axis").value} = ${Number(part("cut").value).toFixed(2)} mm`;
  const legend = part("legend");
  if (legend) legend.hidden = part("colour").value !== "thickness";
  ask();
}

function chooseAxis() {
  const axis = axisNumber();
  if (axis >= 0) {
    const [low, high] = [facts.low[axis], facts.low[axis] + facts.size[axis]];
    Object.assign(part("cut"), { min: low, max: high, step: (high - low) / 400 });
    part("cut").value = (low + high) / 2;
    part("flip").checked = axesOf(aim).eye[axis] < 0; // the half towards the reader goes
  }
  showControls();
}

function connect() {
  part("axis").addEventListener("change", chooseAxis);
  for (const control of document.querySelectorAll("#view input, #view select:not(#view-axis)")) control.addEventListener("input", showControls);
  part("reset").addEventListener("click", reset);
  part("full").addEventListener("click", () => (document.fullscreenElement ? document.exitFullscreen() : document.getElementById("view").requestFullscreen()));
  part("full").hidden = !document.fullscreenEnabled;
  for (const button of document.querySelectorAll("button[data-place]")) {
    button.hidden = false;
    button.addEventListener("click", () => {
      const box = part(`finding-${button.dataset.finding}`);
      if (box) box.checked = true;
      lookAt(button.dataset.place.split(" ").map(Number));
      canvas.scrollIntoView({ block: "center", behavior: isCalm ? "auto" : "smooth" });
      canvas.focus({ preventScroll: true });
    });
  }
  new ResizeObserver(ask).observe(canvas);
}

function showPicture(why) {
  part("none").textContent = `The solid cannot be shown in 3-D here: ${why}.`;
  part("none").hidden = false;
  document.body.classList.remove("has-view");
  document.getElementById("view").hidden = true;
}

async function showView() {
  if (typeof DecompressionStream === "undefined") return showPicture("the browser is too old");
  const options = { antialias: true, alpha: true, premultipliedAlpha: true, preserveDrawingBuffer: true };
  const gl = canvas.getContext("webgl2", options);
  if (!gl) return showPicture("the browser has no WebGL 2");
  const packed = await unpack(part("data").textContent);
  const prepare = () => { draw = makePainter(gl, packed); ask(); };
  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); draw = () => {}; });
  canvas.addEventListener("webglcontextrestored", prepare);
  document.getElementById("view").hidden = false;
  document.body.classList.add("has-view");
  fitIn(packed.places, packed.outerPlaces);
  prepare();
  listen();
  connect();
  chooseAxis();
}

showView().catch((error) => showPicture(error.message));
