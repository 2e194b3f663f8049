// The solid in 3-D: what the reader does, and what of it `painter.js` is to show.

const facts = JSON.parse(document.getElementById("view-facts").textContent);
const axisNumber = () => ["x", "y", "z"].indexOf(part("axis").value);
const part = (name) => document.getElementById(`view-${name}`);
const canvas = part("canvas");
const isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;

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

// How far the solid and the outer shape reach in the view that is shown first, in which they are to stand amid the canvas.
const reach = { across: 1, upward: 1 };
function measureReach(...clouds) {
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
  Object.assign(reach, { across: across.length, upward: upward.length });
}

// The canvas has its size: the first view fits into it, and so does what is shown where the reader has not zoomed.
function fit() {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width || !height) return;
  const isFirst = aim.zoom === start.zoom;
  start.zoom = (0.88 * Math.min(width / reach.across, height / reach.upward) * view.zoom) / zoomOf(width, height);
  if (isFirst) aim.zoom = view.zoom = start.zoom;
  ask();
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

// Where the solid is cut: all beyond, along x, y or z, goes

function cutPlane() {
  const axis = axisNumber();
  const slider = part("cut");
  if (axis < 0) return [0, 0, 0, 1];
  const sign = part("flip").checked ? -1 : 1;
  const place = (Number(slider.value) - facts.low[axis]) / unit;
  return [0, 1, 2].map((each) => (each === axis ? sign : 0)).concat(sign * place);
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
    if (document.activeElement !== canvas) return; // else the page could not be scrolled past it
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
  new ResizeObserver(fit).observe(canvas);
}

function showPicture(why) {
  part("none").textContent = `The solid cannot be shown in 3-D here: ${why}.`;
  part("none").hidden = false;
  document.body.classList.remove("has-view");
  document.getElementById("view").hidden = true;
}

async function showView() {
  if (typeof DecompressionStream === "undefined") return showPicture("the browser is too old");
  const options = { antialias: true, alpha: true, premultipliedAlpha: true };
  const gl = canvas.getContext("webgl2", options);
  if (!gl) return showPicture("the browser has no WebGL 2");
  const packed = await unpack(part("data").textContent);
  const prepare = () => { draw = makePainter(gl, packed); ask(); };
  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); draw = () => {}; });
  canvas.addEventListener("webglcontextrestored", prepare);
  document.getElementById("view").hidden = false;
  document.body.classList.add("has-view");
  measureReach(packed.places, packed.outerPlaces);
  Object.assign(view, Object.assign(aim, start));
  fit();
  prepare();
  listen();
  connect();
  chooseAxis();
}

showView().catch((error) => showPicture(error.message));
