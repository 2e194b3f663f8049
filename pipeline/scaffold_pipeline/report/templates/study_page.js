// The table filters by words; the plot draws a column of numbers against another.
const { titles, varied, rows, first } = JSON.parse(document.getElementById("data").textContent);
const lines = makeSortable(document.querySelector("table.points"), (line, column) => rows[line.dataset.row][column]);
lines.forEach((line, row) => (line.dataset.row = row));
const wanted = new URLSearchParams(location.hash.slice(1)); // #y=porosity&x=... opens the page at a plot

function make(parent, name, attributes = {}, text = "") {
  const node = document.createElementNS(parent.namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== "") node.textContent = text;
  return parent.appendChild(node);
}

// The table

function filter(text, count) {
  const words = text.toLowerCase().split(/\s+/);
  for (const line of lines) line.hidden = !words.every((word) => line.textContent.toLowerCase().includes(word));
  count.textContent = `${lines.filter((line) => !line.hidden).length} of ${lines.length} points`;
  draw();
}

function enliven() {
  const bar = document.getElementById("filter");
  const count = bar.querySelector("output");
  bar.querySelector("input").addEventListener("input", (event) => filter(event.target.value, count));
  bar.hidden = false;
}

// The plot

const isNumber = (value) => typeof value === "number";
const values = (column) => rows.map((row) => row[column]);
const distinct = (column) => new Set(values(column).filter((value) => value !== null).map(String)).size;
const columns = titles.map((_, column) => column);
const own = columns.slice(1, 1 + varied);
const measured = columns.slice(1 + varied).filter((column) => values(column).some(isNumber));
const choose = Object.fromEntries(["y", "x", "by"].map((name) => [name, document.getElementById(name)]));

function offer(name, choices, usual) {
  choices.forEach((column) => make(choose[name], "option", { value: column }, titles[column] ?? "nothing"));
  const named = choices.find((column) => titles[column] === wanted.get(name));
  choose[name].value = named ?? usual;
  choose[name].addEventListener("change", draw);
}

function ticks(low, high) {
  const rough = (high - low) / 5;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const first = Math.ceil(low / step - 1e-9);
  return [...Array(7).keys()].map((index) => (first + index) * step).filter((value) => value <= high + step * 1e-9);
}

// Where values of a column lie between two places: numbers by size, all else one beside the other.
function axis(column, shown, from, to) {
  const found = shown.map((row) => row[column]);
  if (found.every(isNumber)) {
    let [low, high] = [Math.min(...found), Math.max(...found)];
    const room = (high - low) * 0.04 || Math.abs(high) * 0.1 || 1;
    [low, high] = [low - room, high + room];
    const place = (value) => from + ((value - low) / (high - low)) * (to - from);
    return { place, marks: ticks(low, high), text: (value) => String(Number(value.toPrecision(6))), isNumeric: true };
  }
  const marks = [...new Set(found.map(String))];
  const place = (value) => from + ((marks.indexOf(String(value)) + 0.5) / marks.length) * (to - from);
  return { place, marks, text: (value) => value, isNumeric: false };
}

function drawAxes(svg, x, y, tilted) {
  for (const mark of y.marks) {
    make(svg, "line", { class: "grid", x1: 80, x2: 980, y1: y.place(mark), y2: y.place(mark) });
    make(svg, "text", { x: 72, y: y.place(mark) + 5, "text-anchor": "end" }, y.text(mark));
  }
  for (const mark of x.marks) {
    const [left, low] = [x.place(mark), 420];
    make(svg, "line", { class: "grid", x1: left, x2: left, y1: 20, y2: 400 });
    const turn = tilted ? { transform: `rotate(-45 ${left} ${low})`, "text-anchor": "end" } : { "text-anchor": "middle" };
    make(svg, "text", { x: left, y: low, ...turn }, x.text(mark));
  }
}

// A line through the means at each x, and a dot a point.
function drawGroup(svg, group, number, x, y) {
  const [column, row] = [choose.x.value, choose.y.value];
  const parent = make(svg, "g", { class: `group g${number % 6}` });
  const means = new Map();
  for (const point of group) means.set(point[column], [...(means.get(point[column]) ?? []), point[row]]);
  const mean = (found) => found.reduce((sum, value) => sum + value, 0) / found.length;
  const path = [...means].sort((a, b) => a[0] - b[0]).map(([at, found]) => `${x.place(at)},${y.place(mean(found))}`);
  if (x.isNumeric) make(parent, "polyline", { points: path.join(" ") });
  for (const point of group) {
    const dot = make(parent, "circle", { cx: x.place(point[column]), cy: y.place(point[row]), r: 5 });
    make(dot, "title", {}, `${point[0]}: ${titles[row]} ${point[row]}`);
  }
}

function draw() {
  const [svg, caption] = document.getElementById("plot").querySelectorAll("svg, figcaption");
  const [column, row, by] = [choose.x.value, choose.y.value, choose.by.value];
  const visible = lines.filter((line) => !line.hidden).map((line) => Number(line.dataset.row)).sort((a, b) => a - b);
  const shown = visible.map((index) => rows[index]).filter((point) => isNumber(point[row]) && point[column] !== null);
  svg.replaceChildren();
  caption.textContent = shown.length ? `${titles[row]} against ${titles[column]}` : "No point that is shown has both.";
  if (!shown.length) return;
  const [x, y] = [axis(column, shown, 80, 980), axis(row, shown, 400, 20)];
  const tilted = !x.isNumeric && x.marks.join("").length > 80;
  svg.setAttribute("viewBox", `0 0 1000 ${tilted ? 560 : 440}`);
  svg.setAttribute("aria-label", caption.textContent);
  drawAxes(svg, x, y, tilted);
  const groups = new Map();
  for (const point of shown) {
    const label = String(point[by] ?? "");
    groups.set(label, [...(groups.get(label) ?? []), point]);
  }
  [...groups.values()].forEach((group, number) => drawGroup(svg, group, number, x, y));
  if (by === "") return;
  make(caption, "span", {}, `, by ${titles[by]}:`);
  [...groups.keys()].forEach((label, number) => make(caption, "span", { class: `key g${number % 6}` }, label));
}

enliven();
if (measured.length && lines.length) {
  const x = own.find((column) => values(column).every(isNumber) && distinct(column) > 1) ?? own[0] ?? measured[0];
  const others = own.filter((column) => distinct(column) > 1);
  offer("y", measured, measured.find((column) => titles[column] === first) ?? measured[0]);
  offer("x", [...own, ...measured], x);
  offer("by", ["", ...others], others.find((column) => column !== x) ?? "");
  document.getElementById("plot").hidden = false;
  draw();
}
