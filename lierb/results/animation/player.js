"use strict";
// Draws a scene, as lierb/results/animation/scene.py describes it, on canvases; needs no library.

// ---- pure functions: vectors, quaternions (w, x, y, z), time --------------------------------------

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => add([0, 0, 0], a, 1 / (norm(a) || 1));
const mix = (a, b, s) => a + (b - a) * s;

function floats(text, Kind = Float32Array) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Kind(bytes.buffer);
}

function matrix(q) {
  const n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], k = 2 / n, [w, x, y, z] = q;
  return [
    1 - k * (y * y + z * z), k * (x * y - w * z), k * (x * z + w * y),
    k * (x * y + w * z), 1 - k * (x * x + z * z), k * (y * z - w * x),
    k * (x * z - w * y), k * (y * z + w * x), 1 - k * (x * x + y * y),
  ];
}

const turn = (m, v) => [
  m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
  m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
  m[6] * v[0] + m[7] * v[1] + m[8] * v[2],
];

function product(a, b) {
  const m = [];
  for (let i = 0; i < 9; i += 3)
    for (let j = 0; j < 3; j++) m.push(a[i] * b[j] + a[i + 1] * b[j + 3] + a[i + 2] * b[j + 6]);
  return m;
}

/** The rotation by a rotation vector, as a matrix. */
function rotation(xi) {
  const angle = norm(xi), e = unit(xi), s = Math.sin(angle / 2);
  return matrix([Math.cos(angle / 2), s * e[0], s * e[1], s * e[2]]);
}

/** The saved time at or before t, and which part of the way to the next one has gone. */
function moment(times, t) {
  let low = 0, high = times.length - 1;
  if (high < 1 || !(t > times[0])) return [0, 0];
  if (t >= times[high]) return [high, 0];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  return [low, (t - times[low]) / (times[high] - times[low])];
}

/** A row of so many numbers, between two saved times on a straight line. */
function between(numbers, width, k, s) {
  const row = [];
  for (let i = k * width; i < (k + 1) * width; i++) row.push(s ? mix(numbers[i], numbers[i + width], s) : numbers[i]);
  return row;
}

/** A body's pose: {m, p}, between two saved times by the shorter way; null after a failure. */
function poseAt(poses, k, s) {
  const a = between(poses, 7, k, 0);
  if (!a.every(Number.isFinite)) return null;
  if (s > 0) {
    const b = between(poses, 7, k + 1, 0);
    if (!b.every(Number.isFinite)) return { m: matrix(a), p: a.slice(4) };
    const sign = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? -1 : 1;
    for (let i = 0; i < 4; i++) a[i] = mix(a[i], sign * b[i], s);
    for (let i = 4; i < 7; i++) a[i] = mix(a[i], b[i], s);
  }
  return { m: matrix(a), p: a.slice(4) };
}

const place = (pose, point) => (pose ? add(turn(pose.m, point), pose.p) : point);
const origin = (frame) => [frame[3], frame[7], frame[11]];
const axis = (frame, i) => [frame[i], frame[4 + i], frame[8 + i]];

/** Poses of a view's bodies, each joint's gap opened so many times as wide; joints' points and gaps. */
function shown(view, k, s, factor) {
  const bodies = view.bodies.map((body) => poseAt(body.poses, k, s)), drawn = [...bodies];
  const joints = view.joints.map((joint) => {
    const was = bodies[joint.child], arm = origin(joint.child_frame);
    if (!was) return null;
    const gap = between(joint.gap, 6, k, s), moved = gap.slice(3), point = place(was, arm);
    if (joint.closes) { // its bodies are where the joints of the links have them
      const end = place(drawn[joint.child], arm);
      return { point: end, allowed: add(end, moved, -factor), gap: norm(moved), turned: norm(gap) };
    }
    let shift = [0, 0, 0]; // by which what it hangs on is displaced
    if (joint.parent !== null && bodies[joint.parent]) {
      const on = origin(joint.parent_frame);
      shift = add(place(drawn[joint.parent], on), place(bodies[joint.parent], on), -1);
    }
    const m = product(rotation(add([0, 0, 0], gap, factor - 1)), was.m);
    const end = add(add(point, moved, factor - 1), shift);
    drawn[joint.child] = { m, p: add(end, turn(m, arm), -1) };
    return { point: end, allowed: add(add(point, moved, -1), shift), gap: norm(moved), turned: norm(gap) };
  });
  return { bodies: drawn, joints };
}

/** Axes of a camera that looks at the scene: from it, to the right, up. */
function cameraAxes(up, yaw, pitch) {
  const start = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const a = unit(add(start, up, -dot(start, up))), b = cross(up, a);
  const level = add([0, 0, 0].map((_, i) => Math.cos(yaw) * a[i]), b, Math.sin(yaw));
  const back = add(level.map((x) => x * Math.cos(pitch)), up, Math.sin(pitch));
  const forward = back.map((x) => -x), right = unit(cross(forward, up));
  return { forward, right, up: cross(right, forward) };
}

const HALF_ANGLE = (15 * Math.PI) / 180; // of the smaller side of a view

/** Where a point is on the canvas: x, y, depth. rect: of the view; centre: what the camera looks at. */
function project(camera, rect, centre, point) {
  const d = add(point, centre, -1), { forward, right, up } = camera.axes;
  const depth = dot(d, forward) + camera.distance;
  const scale = (0.5 * Math.min(rect.w, rect.h)) / Math.tan(HALF_ANGLE) / Math.max(depth, 1e-3 * camera.distance);
  return [rect.x + rect.w / 2 + scale * dot(d, right), rect.y + rect.h / 2 - scale * dot(d, up), depth];
}

/** Rectangles of so many views, as large as they get. */
function layout(count, width, height) {
  let best = [0, 1];
  for (let across = 1; across <= count; across++) {
    const side = Math.min(width / across, height / Math.ceil(count / across));
    if (side > best[0] + 0.5) best = [side, across];
  }
  const across = best[1], w = width / across, h = height / Math.ceil(count / across);
  return Array.from({ length: count }, (_, i) => ({ x: (i % across) * w, y: Math.floor(i / across) * h, w, h }));
}

const NARROWEST = 125; // pixels of a strip with its axis
/** Boxes of so many strips beside each other, in as many rows as their least width asks for. */
function strips(count, width, height) {
  const rows = Math.ceil(count / Math.max(1, Math.floor(width / NARROWEST))), across = Math.ceil(count / rows);
  const w = width / across, h = height / rows;
  const boxes = Array.from({ length: count }, (_, i) => ({ x: (i % across) * w + 44, y: Math.floor(i / across) * h + 20, w: w - 54, h: h - 38 }));
  return { rows, boxes };
}

/** The convex hull of points in the plane, in order. */
function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (list) => {
    const out = [];
    for (const p of list) {
      while (out.length > 1) {
        const [a, b] = out.slice(-2);
        if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
        out.pop();
      }
      out.push(p);
    }
    return out.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** 1, 2 or 5 times a power of ten, at or below. */
function nice(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * [5, 2, 1].find((n) => n * power <= x * 1.0000001);
}

const digits = "⁰¹²³⁴⁵⁶⁷⁸⁹";
const power = (n) => "10" + (n < 0 ? "⁻" : "") + [...String(Math.abs(n))].map((d) => digits[d]).join("");

function short(x) {
  if (!x) return "0";
  const n = Math.floor(Math.log10(Math.abs(x)) + 1e-9);
  if (n > -4 && n < 5) return String(+x.toPrecision(3));
  return `${(x / 10 ** n).toFixed(1)}·${power(n)}`;
}

if (typeof module !== "undefined")
  module.exports = { cameraAxes, floats, hull, layout, matrix, moment, nice, poseAt, project, rotation, short, shown, strips, turn };

// ---- the player -----------------------------------------------------------------------------------

if (typeof document !== "undefined") start(JSON.parse(document.getElementById("scene").textContent));

function start(scene) {
  const rgb = (colour) => [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16));
  const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3]];
  const TRAIL = 400; // frames
  const MOST_NAMED = 12; // links whose names are written in their colours
  const $ = (id) => document.getElementById(id);
  const stage = document.querySelector("#stage canvas"), strip = document.querySelector("#strip canvas");
  const framed = window.parent !== window;
  if (framed) document.documentElement.className = "framed";

  for (const view of scene.views) {
    const others = scene.colours.filter((colour) => colour !== view.colour); // of further bodies
    view.tints = view.bodies.map((_, i) => rgb(i ? others[(i - 1) % others.length] : view.colour));
    view.dash = DASHES[view.dash % DASHES.length];
    view.t = floats(view.t, Float64Array);
    for (const joint of view.joints) joint.gap = floats(joint.gap);
    for (const name in view.values) view.values[name] = floats(view.values[name]);
    for (const body of view.bodies) {
      body.poses = floats(body.poses);
      const { vertices, faces } = body.shape;
      body.shape.normals = faces.map(([a, b, c]) =>
        unit(cross(add(vertices[b], vertices[a], -1), add(vertices[c], vertices[b], -1))));
    }
  }
  const begin = Math.min(...scene.views.map((v) => v.t[0]));
  const end = Math.max(...scene.views.map((v) => v.t[v.t.length - 1]));
  const curves = Object.keys(scene.curves);
  const home = () => ({ yaw: 0.6, pitch: 0.32, distance: (1.1 * scene.radius) / Math.sin(HALF_ANGLE), axes: null });
  let camera = home(), t = begin, playing = false, factor = 1, speed = 1, last = 0, wanted = true;
  const orient = () => (camera.axes = cameraAxes(scene.up, camera.yaw, camera.pitch));
  orient();

  // ---- a view ----

  function sized(canvas) {
    const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    return [pen, w, h];
  }

  function line(pen, points, colour, width, dash = []) {
    pen.beginPath();
    points.forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.stroke();
  }

  function disc(pen, p, radius, fill, edge) {
    pen.beginPath();
    pen.arc(p[0], p[1], radius, 0, 7);
    pen.setLineDash([]);
    pen.lineWidth = 1.5;
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (edge) { pen.strokeStyle = edge; pen.stroke(); }
  }

  const fill = (pen, points, colour) => {
    pen.beginPath();
    points.forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
    pen.closePath();
    pen.fillStyle = colour;
    pen.fill();
  };

  /** On a light ground of its own: a body may be behind it. */
  function label(pen, text, x, y, width) {
    pen.lineWidth = 3;
    pen.setLineDash([]);
    pen.strokeStyle = "rgba(255,255,255,0.85)";
    pen.strokeText(text, x, y, width);
    pen.fillText(text, x, y, width);
  }

  const floor = scene.floor;
  const grid = nice(scene.radius / 2);

  function drawFloor(pen, see, bodies, view) {
    const a = camera.level[0], b = camera.level[1], up = scene.up;
    const at = (i, j) => see([0, 1, 2].map((n) => i * a[n] + j * b[n] + floor * up[n]));
    const reach = Math.ceil((1.3 * scene.radius) / grid);
    const ca = Math.round(dot(scene.centre, a) / grid), cb = Math.round(dot(scene.centre, b) / grid);
    pen.beginPath(); // one for all: a frame has few milliseconds
    for (let i = -reach; i <= reach; i++)
      for (const [p, q] of [
        [at((ca + i) * grid, (cb - reach) * grid), at((ca + i) * grid, (cb + reach) * grid)],
        [at((ca - reach) * grid, (cb + i) * grid), at((ca + reach) * grid, (cb + i) * grid)],
      ]) { pen.moveTo(p[0], p[1]); pen.lineTo(q[0], q[1]); }
    pen.strokeStyle = "#e8e8e8";
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.stroke();
    bodies.forEach((pose, n) => {
      if (!pose) return;
      const low = view.bodies[n].shape.vertices.map((v) => place(pose, v)).map((p) => see(add(p, up, floor - dot(p, up))));
      fill(pen, hull(low), "rgba(0,0,0,0.09)");
    });
  }

  function faces(body, pose, see, colour, out) {
    const { vertices, faces: polygons, normals, marked } = body.shape;
    const seen = vertices.map((v) => see(place(pose, v)));
    polygons.forEach((polygon, n) => {
      const points = polygon.map((i) => seen[i]);
      let area = 0, depth = 0;
      points.forEach((p, i) => {
        const next = points[(i + 1) % points.length];
        area += p[0] * next[1] - p[1] * next[0];
        depth += p[2] / points.length;
      });
      if (area >= 0) return; // it looks away; y points down
      const normal = turn(pose.m, normals[n]);
      const light = 0.62 + 0.3 * Math.max(0, -dot(normal, camera.axes.forward)) + 0.16 * dot(normal, camera.light);
      const white = marked.includes(n) ? 0.45 : 0;
      out.push({ points, depth, colour: colour.map((c) => Math.min(255, Math.round(mix(c, 255, white) * light))) });
    });
  }

  /** A trail's points at all saved times, as they are drawn with this factor; NaN after a failure. */
  function trailOf(view, n) {
    const body = view.bodies[n];
    if (!body.path || body.pathFactor !== factor) {
      body.pathFactor = factor;
      body.path = new Float64Array(3 * view.t.length).fill(NaN);
      for (let k = 0; k < view.t.length; k++) {
        const pose = shown(view, k, 0, factor).bodies[n];
        if (pose) body.path.set(place(pose, body.trail), 3 * k);
      }
    }
    return body.path;
  }

  /** The way of a body's point up to now, fading; written out, since it has most of a frame's points. */
  function drawTrail(pen, view, n, k, head, rect, colour) {
    if (!view.bodies[n].trail || !head) return;
    const path = trailOf(view, n), first = Math.max(0, k - TRAIL), parts = 8;
    const now = place(head, view.bodies[n].trail), [cx, cy, cz] = view.centre || scene.centre;
    const { forward: f, right: r, up: u } = camera.axes, size = (0.5 * Math.min(rect.w, rect.h)) / Math.tan(HALF_ANGLE);
    const mx = rect.x + rect.w / 2, my = rect.y + rect.h / 2;
    pen.lineWidth = 1.6;
    pen.setLineDash([]);
    for (let part = 0; part < parts; part++) {
      const from = first + Math.floor((part * (k - first)) / parts), to = first + Math.floor(((part + 1) * (k - first)) / parts);
      pen.beginPath();
      for (let i = from; i <= to + (part === parts - 1); i++) {
        const last = i > k, x = (last ? now[0] : path[3 * i]) - cx, y = (last ? now[1] : path[3 * i + 1]) - cy, z = (last ? now[2] : path[3 * i + 2]) - cz;
        const scale = size / Math.max(f[0] * x + f[1] * y + f[2] * z + camera.distance, 1e-3 * camera.distance);
        pen.lineTo(mx + scale * (r[0] * x + r[1] * y + r[2] * z), my - scale * (u[0] * x + u[1] * y + u[2] * z));
      }
      pen.strokeStyle = `rgba(${colour},${0.12 + (0.7 * part) / parts})`;
      pen.stroke();
    }
  }

  function drawJoint(pen, view, joint, at, child, parent, see) {
    const dark = "#444", size = scene.size;
    const across = (frame, pose, i, reach, colour, dash) => {
      const o = place(pose, origin(frame)), d = pose ? turn(pose.m, axis(frame, i)) : axis(frame, i);
      line(pen, [see(add(o, d, -reach)), see(add(o, d, reach))], colour, 1.2, dash);
    };
    for (const i of joint.slides) across(joint.parent_frame, parent, i, 1.2 * scene.radius, "#999", [6, 4]);
    for (const i of joint.child_slides) across(joint.child_frame, child, i, size, "#999", [6, 4]);
    for (const i of joint.parent_axes) across(joint.parent_frame, parent, i, 0.45 * size, dark, [5, 3]);
    for (const i of joint.child_axes) across(joint.child_frame, child, i, 0.3 * size, dark, []);
    if (joint.is_rod) line(pen, [see(place(parent, origin(joint.parent_frame))), see(at.point)], dark, 2);
    const body = view.bodies[joint.child];
    if (child && !body.bones) line(pen, [see(at.point), see(place(child, body.com))], "rgba(60,60,60,0.55)", 2); // massless
    disc(pen, see(at.allowed), 5.5, "#fff", dark);
    line(pen, [see(at.allowed), see(at.point)], "#c00", 2);
    disc(pen, see(at.point), 3, "#c00", null);
  }

  function drawFrame(pen, see) {
    const o = see([0, 0, 0]);
    ["e₁", "e₂", "e₃"].forEach((name, i) => {
      const tip = see([0, 1, 2].map((n) => (n === i ? 0.3 * scene.size : 0)));
      line(pen, [o, tip], "#888", 1.2);
      label(pen, name, tip[0] + 3, tip[1] - 3);
    });
  }

  /** Directions of the ground's axes in a corner, where its origin is out of sight. */
  function drawDirections(pen, rect) {
    const { right, up } = camera.axes, o = [rect.x + 42, rect.y + rect.h - 46];
    ["e₁", "e₂", "e₃"].forEach((name, i) => {
      const tip = [o[0] + 28 * right[i], o[1] - 28 * up[i]];
      line(pen, [o, tip], "#888", 1.2);
      label(pen, name, o[0] + 38 * right[i] - 5, o[1] - 38 * up[i] + 4);
    });
  }

  /** Targets: a cross for a point, a line for a path, axes for a pose; their names beside them. */
  function drawTargets(pen, see) {
    const colour = "#a0178c", arm = 0.08 * scene.size;
    pen.fillStyle = colour;
    for (const { name, points, axes } of scene.targets) {
      line(pen, points.map(see), colour, 1.6, [2, 2]);
      if (points.length === 1) for (let i = 0; i < 3; i++) {
        const d = [0, 1, 2].map((n) => (n === i ? arm : 0));
        line(pen, [see(add(points[0], d, -1)), see(add(points[0], d))], colour, 1.8);
      }
      if (axes) drawAxes(pen, see, { m: axes.flat(), p: points[0] });
      const [x, y] = see(points[points.length - 1]);
      label(pen, name, x + 7, y - 7);
    }
  }

  /** The axes of a body's frame: red, green, blue. */
  function drawAxes(pen, see, pose) {
    ["#c33", "#393", "#33c"].forEach((colour, i) => {
      const tip = [0, 1, 2].map((n) => (n === i ? 0.3 * scene.size : 0));
      line(pen, [see(pose.p), see(place(pose, tip))], colour, 1.4);
    });
  }

  function drawView(pen, view, rect) {
    pen.save();
    pen.beginPath();
    pen.rect(rect.x, rect.y, rect.w, rect.h);
    pen.clip();
    const [k, s] = moment(view.t, t), { bodies, joints } = shown(view, k, s, factor);
    const alive = bodies.filter(Boolean);
    if (alive.length) view.centre = scene.follow ? alive.reduce((c, b) => add(c, b.p, 1 / alive.length), [0, 0, 0]) : scene.centre;
    const see = (point) => project(camera, rect, view.centre || scene.centre, point);
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = "#777";
    if (floor !== null) drawFloor(pen, see, bodies, view);
    pen.fillStyle = "#777";
    const [x, y] = see([0, 0, 0]);
    if (x > rect.x && x < rect.x + rect.w && y > rect.y && y < rect.y + rect.h) drawFrame(pen, see);
    else drawDirections(pen, rect);
    const polygons = [];
    bodies.forEach((pose, i) => {
      const colour = view.tints[i];
      drawTrail(pen, view, i, k, pose, rect, colour);
      if (pose) faces(view.bodies[i], pose, see, colour, polygons);
    });
    polygons.sort((a, b) => b.depth - a.depth);
    for (const { points, colour } of polygons) {
      fill(pen, points, `rgb(${colour})`);
      line(pen, [...points, points[0]], `rgba(${colour.map((c) => Math.round(0.75 * c))},0.55)`, 0.7);
    }
    if (bodies.length <= MOST_NAMED) for (const pose of alive) drawAxes(pen, see, pose);
    bodies.forEach((pose, i) => {
      if (pose) for (const ends of view.bodies[i].bones || [])
        line(pen, ends.map((point) => see(place(pose, point))), "rgba(60,60,60,0.55)", 2);
    });
    view.joints.forEach((joint, i) =>
      joints[i] && drawJoint(pen, view, joint, joints[i], bodies[joint.child], joint.parent === null ? null : bodies[joint.parent], see));
    drawTargets(pen, see);
    pen.fillStyle = view.colour;
    if (view.title && !view.dash.length) pen.fillRect(rect.x + 8, rect.y + 8, 11, 11);
    else if (view.title) line(pen, [[rect.x + 2, rect.y + 14], [rect.x + 21, rect.y + 14]], view.colour, 3, view.dash);
    pen.fillStyle = "#1a1a1a";
    pen.font = "600 13px system-ui, sans-serif";
    label(pen, view.title, rect.x + 24, rect.y + 18, rect.w - 30);
    pen.font = "12px system-ui, sans-serif";
    const gap = Math.max(0, ...joints.filter(Boolean).map((j) => j.gap));
    const told = alive.length < bodies.length ? "failed: there is no state any more"
      : joints.length ? `gap ${short(gap)} m` + (factor > 1 ? `, shown × ${short(factor)}` : "") : "";
    pen.fillStyle = alive.length < bodies.length ? "#b00020" : "#555";
    const below = rect.y + (view.title ? 35 : 18);
    label(pen, told, rect.x + 8, below, rect.w - 14);
    if (view.bodies.length > 1) view.bodies.slice(0, MOST_NAMED).forEach((body, i) => {
      pen.fillStyle = `rgb(${view.tints[i].map((c) => Math.round(0.8 * c))})`;
      label(pen, body.name, rect.x + 8, below + (told ? 17 : 0) + 15 * i, rect.w - 14);
    });
    pen.restore();
  }

  function draw() {
    const [pen, w, h] = sized(stage), rects = layout(scene.views.length, w, h), up = camera.axes.up;
    const start = Math.abs(scene.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], a = unit(add(start, scene.up, -dot(start, scene.up)));
    camera.level = [a, cross(scene.up, a)];
    camera.light = unit(add(add(up, camera.axes.right, -0.5), scene.up));
    scene.views.forEach((view, n) => drawView(pen, view, rects[n]));
    for (const rect of rects) if (rect.x > 0) line(pen, [[rect.x, rect.y + 6], [rect.x, rect.y + rect.h - 6]], "#e2e2e2", 1);
    if (floor !== null) {
      pen.fillStyle = "#777";
      pen.font = "11px system-ui, sans-serif";
      pen.fillText(`grid ${short(grid)} m`, 8, h - 7);
    }
    drawCurves();
  }

  // ---- errors and observables over time ----

  /** Ends of a linear axis, a little beyond all values. */
  function ends(name) {
    const all = scene.views.flatMap((view) => Array.from(view.values[name] || []).filter(Number.isFinite));
    if (!all.length) return null;
    const low = Math.min(...all), high = Math.max(...all), margin = 0.05 * (high - low) || 0.5 * Math.abs(high) || 1;
    return { linear: true, bottom: low - margin, top: high + margin };
  }

  /** Decades of an axis, and whether there are zeros, which are drawn on its lowest line. */
  function ranges(name) {
    if (scene.linear.includes(name)) return ends(name);
    let low = Infinity, high = 0, zeros = false;
    for (const view of scene.views) (view.values[name] || []).forEach((x, k) => {
      if (x > 0) { low = Math.min(low, x); high = Math.max(high, x); }
      if (x === 0 && k) zeros = true; // but for the start, which has no error yet
    });
    if (!(high > 0)) return null;
    const top = Math.ceil(Math.log10(high) + 1e-9), bottom = Math.max(Math.floor(Math.log10(low)), top - 10);
    return { zeros, top: Math.max(top, bottom + 1), bottom: bottom - zeros };
  }
  const bounds = curves.map(ranges);
  const boxes = (w, h) => strips(curves.length, w, h).boxes;

  const still = document.createElement("canvas"); // the curves, which time does not change
  const across = (box, x) => box.x + ((x - begin) / (end - begin || 1)) * box.w;

  function drawCurves() {
    if (curves.length) $("strip").style.setProperty("--rows", strips(curves.length, strip.clientWidth, 0).rows);
    const [pen, w, h] = sized(strip);
    if (still.width !== strip.width || still.height !== strip.height) {
      still.width = strip.width;
      still.height = strip.height;
      drawStill(w, h);
    }
    if (still.width && still.height) pen.drawImage(still, 0, 0, w, h);
    for (const box of boxes(w, h)) {
      const x = across(box, t);
      line(pen, [[x, box.y - 2], [x, box.y + box.h + 3]], "#1a1a1a", 1);
    }
  }

  function drawStill(w, h) {
    const pen = still.getContext("2d"), ratio = still.width / (w || 1);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    boxes(w, h).forEach((box, i) => {
      const name = curves[i], range = bounds[i];
      pen.font = "12px system-ui, sans-serif";
      pen.fillStyle = "#1a1a1a";
      pen.fillText(scene.curves[name], box.x - 38, box.y - 8, box.w + 40);
      pen.fillStyle = "#666";
      pen.font = "11px system-ui, sans-serif";
      if (!range) {
        const isNumber = scene.views.some((view) => view.values[name]?.some(Number.isFinite));
        pen.fillText(isNumber ? "exactly 0" : "not a number", box.x, box.y + box.h / 2, box.w);
      } else {
        const height = (x) => range.linear ? x : Math.max(range.bottom, Math.log10(Math.max(x, 1e-300)));
        const up = (x) => box.y + box.h * (1 - (height(x) - range.bottom) / (range.top - range.bottom));
        const every = range.linear ? nice((range.top - range.bottom) / Math.max(1, Math.floor(box.h / 24)))
          : Math.ceil((range.top - range.bottom) / Math.max(2, Math.floor(box.h / 18)));
        for (let n = Math.ceil(range.bottom / every - 1e-9) * every; n <= range.top; n += every) {
          const at = range.linear ? up(n) : up(10 ** n), tiny = 1e-9 * every;
          line(pen, [[box.x, at], [box.x + box.w, at]], "#e6e6e6", 1);
          pen.fillText(range.linear ? short(Math.abs(n) < tiny ? 0 : n) : n === range.bottom && range.zeros ? "0" : power(n), box.x - 38, at + 4);
        }
        const count = scene.views.length;
        scene.views.forEach((view, n) => { // the first the thickest: none hides another
          const points = Array.from(view.values[name] || [], (x, k) => [across(box, view.t[k]), up(x), x]);
          line(pen, points.filter((p, k) => p[2] === p[2] && (k || range.linear || p[2] > 0)), view.colour, 1.3 + (2.2 * (count - 1 - n)) / count, view.dash);
        });
      }
      pen.fillStyle = "#666";
      pen.fillText(`${short(begin)} s`, box.x, box.y + box.h + 14);
      const last = `${short(end)} s`;
      pen.fillText(last, box.x + box.w - pen.measureText(last).width, box.y + box.h + 14);
    });
  }

  // ---- controls ----

  const texts = {}, put = (id, text) => { if (texts[id] !== text) $(id).textContent = texts[id] = text; };
  function show() {
    put("play", playing ? "❚❚" : "▶");
    $("scrub").value = (t - begin) / (end - begin || 1);
    const figures = Math.max(0, Math.min(4, 3 - Math.floor(Math.log10(end - begin || 1))));
    put("time", `${t.toFixed(figures)} s of ${short(end)} s`);
    put("speeds", speed >= 1 ? `× ${speed}` : `× 1/${1 / speed}`);
    put("factor", short(Math.round(factor) < 10 ? +factor.toFixed(1) : factor));
    wanted = true;
  }

  function seek(to) { t = Math.min(end, Math.max(begin, to)); show(); }
  function play(on) { playing = on; if (on && t >= end) t = begin; last = 0; show(); }
  function pace(exponent) { exponent = Math.max(-10, Math.min(10, exponent)); speed = 2 ** exponent; $("speed").value = exponent; show(); }
  function magnify(to) { factor = to; $("magnify").value = Math.log(factor) / Math.log(scene.magnify) || 0; show(); }
  function orbit(yaw, pitch) {
    camera.yaw += yaw;
    camera.pitch = Math.max(-1.5, Math.min(1.5, camera.pitch + pitch));
    orient();
    wanted = true;
  }
  function zoom(by) {
    const far = home().distance;
    camera.distance = Math.max(0.05 * far, Math.min(20 * far, camera.distance * by));
    wanted = true;
  }
  function step(by) {
    const times = scene.views[0].t, [k, s] = moment(times, t);
    play(false);
    seek(times[Math.max(0, Math.min(times.length - 1, by > 0 || s === 0 ? k + by : k))]);
  }
  function reset() { camera = home(); orient(); wanted = true; }

  $("play").onclick = () => play(!playing);
  $("scrub").oninput = (e) => { play(false); seek(begin + e.target.value * (end - begin)); };
  $("speed").oninput = (e) => pace(+e.target.value);
  $("magnify").oninput = (e) => { factor = scene.magnify ** e.target.value; show(); };
  $("reset").onclick = reset;
  if (scene.magnify <= 1) $("gaps").style.display = "none";
  for (const text of scene.notes) {
    const p = document.createElement("p");
    p.className = "note";
    p.textContent = text;
    $("notes").append(p);
  }
  $("help").textContent = `drag or arrows: turn · ${framed ? "Ctrl + " : ""}wheel, pinch or + −: zoom · space: play · , and .: saved time by saved time · [ ]: speed`
    + (scene.follow ? " · the camera goes with the bodies" : "");
  if (!curves.length) $("strip").style.display = "none";

  const held = new Map();
  stage.addEventListener("pointerdown", (e) => { stage.setPointerCapture(e.pointerId); held.set(e.pointerId, [e.clientX, e.clientY]); });
  for (const kind of ["pointerup", "pointercancel"]) stage.addEventListener(kind, (e) => held.delete(e.pointerId));
  stage.addEventListener("pointermove", (e) => {
    const was = held.get(e.pointerId);
    if (!was) return;
    const now = [e.clientX, e.clientY];
    if (held.size === 1) orbit(-0.008 * (now[0] - was[0]), 0.008 * (now[1] - was[1]));
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== e.pointerId)[1], far = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      if (far(now) > 1) zoom(far(was) / far(now));
    }
    held.set(e.pointerId, now);
  });
  stage.addEventListener("wheel", (e) => {
    if (framed && !e.ctrlKey && !e.metaKey) return; // it scrolls the page around
    e.preventDefault();
    zoom(Math.exp(0.0015 * e.deltaY));
  }, { passive: false });
  const scrubbing = (e) => {
    if (!e.buttons) return;
    const rect = strip.getBoundingClientRect(), x = e.clientX - rect.left, y = e.clientY - rect.top;
    const box = boxes(rect.width, rect.height).find((b) => x >= b.x - 20 && x <= b.x + b.w + 20 && y >= b.y - 20 && y <= b.y + b.h + 18);
    if (box) { play(false); seek(begin + ((x - box.x) / box.w) * (end - begin)); }
  };
  strip.addEventListener("pointerdown", scrubbing);
  strip.addEventListener("pointermove", scrubbing);
  const KEYS = {
    " ": () => play(!playing), ",": () => step(-1), ".": () => step(1), Home: () => seek(begin), End: () => seek(end),
    ArrowLeft: () => orbit(-0.08, 0), ArrowRight: () => orbit(0.08, 0), ArrowUp: () => orbit(0, 0.08), ArrowDown: () => orbit(0, -0.08),
    "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1 / 0.9), 0: reset,
    "[": () => pace(Math.log2(speed) - 1), "]": () => pace(Math.log2(speed) + 1),
  };
  document.addEventListener("keydown", (e) => {
    const typed = e.target.tagName === "INPUT" || (e.target.tagName === "BUTTON" && e.key === " ");
    if (typed || e.ctrlKey || e.metaKey || e.altKey || !KEYS[e.key]) return;
    e.preventDefault();
    KEYS[e.key]();
  });
  new ResizeObserver(() => (wanted = true)).observe(stage);

  function tick(now) {
    if (playing) {
      if (last) t += (speed * (now - last)) / 1000;
      last = now;
      if (t > end) t = begin + ((t - begin) % (end - begin || 1));
      show();
    }
    if (wanted) { wanted = false; draw(); }
    requestAnimationFrame(tick);
  }
  const length = end - begin || 1; // s; the whole takes a quarter of a minute where real time does not suit
  pace(length >= 2 && length <= 60 ? 0 : Math.round(Math.log2(length / 15)));
  magnify(scene.magnified);
  play(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  requestAnimationFrame(tick);
  const seen = (n, point) => project(camera, layout(scene.views.length, stage.clientWidth, stage.clientHeight)[n], scene.views[n].centre || scene.centre, point);
  window.lierb = { scene, draw, seek, play, magnify, orbit, zoom, seen, camera: () => camera };
}
