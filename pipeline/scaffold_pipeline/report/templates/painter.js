// The solid in 3-D, drawn with WebGL 2 only. `viewer.js`, which follows, has the controls.
// Not by k3d: it adds 2.5 MB to each page, loads fonts, starts a worker and evaluates text as code, which the page's policy
// forbids.

const COSINE = Math.cos((35 * Math.PI) / 180); // triangles that meet at a sharper edge are not shaded as one

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
  if (!gl_FrontFacing) { shown = vec4(cap, 1.0); return; }
  vec3 n = normalize(facing);
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

// The normal of each triangle, as long as twice its area.
function faceNormals(places, faces) {
  const normals = new Float32Array(faces.length);
  for (let i = 0; i < faces.length; i += 3) {
    const [a, b, c] = [3 * faces[i], 3 * faces[i + 1], 3 * faces[i + 2]];
    const [ux, uy, uz] = [places[b] - places[a], places[b + 1] - places[a + 1], places[b + 2] - places[a + 2]];
    const [vx, vy, vz] = [places[c] - places[a], places[c + 1] - places[a + 1], places[c + 2] - places[a + 2]];
    normals[i] = uy * vz - uz * vy;
    normals[i + 1] = uz * vx - ux * vz;
    normals[i + 2] = ux * vy - uy * vx;
  }
  return normals;
}

// The corners of triangles at each vertex: those of vertex v are order[starts[v]] to order[starts[v + 1] - 1].
function cornersAt(faces, count) {
  const starts = new Uint32Array(count + 1);
  for (const vertex of faces) starts[vertex + 1]++;
  for (let v = 0; v < count; v++) starts[v + 1] += starts[v];
  const [order, next] = [new Uint32Array(faces.length), starts.slice()];
  for (let corner = 0; corner < faces.length; corner++) order[next[faces[corner]]++] = corner;
  return { starts, order };
}

// Vertices with a normal each, the mean of the triangles that bend little there; at an edge a vertex becomes several.
function shaded({ places, faces, thickness }) {
  const count = places.length / 3;
  const { starts, order } = cornersAt(faces, count);
  const normals = faceNormals(places, faces);
  const [own, corners, sums] = [[], new Uint32Array(faces.length), []]; // own[k]: the vertex that k is a copy of
  for (let v = 0; v < count; v++) {
    const first = own.length;
    for (let at = starts[v]; at < starts[v + 1]; at++) {
      const face = order[at] - (order[at] % 3);
      const [x, y, z] = [normals[face], normals[face + 1], normals[face + 2]];
      let group = first;
      while (group < own.length) {
        const [X, Y, Z] = [sums[3 * group], sums[3 * group + 1], sums[3 * group + 2]];
        if (x * X + y * Y + z * Z >= COSINE * Math.hypot(x, y, z) * Math.hypot(X, Y, Z)) break;
        group++;
      }
      if (group === own.length) { own.push(v); sums.push(0, 0, 0); }
      sums[3 * group] += x; sums[3 * group + 1] += y; sums[3 * group + 2] += z;
      corners[order[at]] = group;
    }
  }
  return copied(places, thickness, own, sums, corners);
}

function copied(places, thickness, own, sums, faces) {
  const copy = { places: new Uint16Array(3 * own.length), normals: new Int8Array(4 * own.length), faces };
  if (thickness?.length) copy.thickness = Uint8Array.from(own, (v) => thickness[v]);
  own.forEach((v, k) => {
    const length = Math.hypot(sums[3 * k], sums[3 * k + 1], sums[3 * k + 2]) || 1;
    for (let axis = 0; axis < 3; axis++) {
      copy.places[3 * k + axis] = places[3 * v + axis];
      copy.normals[4 * k + axis] = Math.round((127 * sums[3 * k + axis]) / length);
    }
  });
  return copy;
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

// Pictures

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

function makePainter(gl, packed) {
  const [surface, glass, mark] = [SURFACE, GLASS, MARK].map((fragment) => makeProgram(gl, fragment));
  const solid = makeShape(gl, shaded(packed));
  const outer = facts.outerFaces && makeShape(gl, shaded({ places: packed.outerPlaces, faces: packed.outerFaces }));
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

