// Layers. What is drawn on the map, in which order and colour? Each layer is a function; the list of layers makes the menu.

import { degrees } from "./dom.js";
import { NEAR_TO_FAR } from "./grid.js";
import { drawGoal, drawPlace, drawZone, label, path } from "./pen.js";
import { store } from "./store.js";

const TAU = 2 * Math.PI;
/** Colours of speed, from rest to the plan's greatest. */
export const RAMP = ["#7c5cff", "#4f7dff", "#2aa5f5", "#17c3c9", "#3ed598", "#a5dc4a", "#f3d13a"];

/** A run of colours, as CSS. */
export const gradient = (colours) => `linear-gradient(90deg, ${colours.join(", ")})`;

/** Name, title, whether it shows at first, background of its sign. */
export const layers = {
  map: { title: "Map", on: true, sign: "var(--map-wall)" },
  clearance: { title: "Clearance", on: false, sign: gradient(NEAR_TO_FAR) },
  trail: { title: "Trail", on: true, sign: "var(--trail)" },
  scan: { title: "Scan", on: true, sign: "var(--scan)" },
  plan: { title: "Plan, coloured by speed", on: true, sign: gradient(RAMP) },
  corridor: { title: "Corridor of the plan", on: true, sign: "var(--accent)" },
  swath: { title: "Footprint along the plan", on: true, sign: "var(--good)" },
  tree: { title: "Search tree", on: false, sign: "var(--tree)" },
  graph: { title: "Pose graph", on: false, sign: "var(--soft)" },
  obstacles: { title: "Moving obstacles", on: true, sign: "var(--mover)" },
  markers: { title: "Markers", on: true, sign: "var(--marker)" },
  zones: { title: "Zones", on: true, sign: "var(--bad)" },
  places: { title: "Places", on: true, sign: "var(--place)" },
  goals: { title: "Goals", on: true, sign: "var(--goal)" },
  robots: { title: "Other robots", on: true, sign: "var(--other)" },
  grid: { title: "Grid", on: true, sign: "var(--soft)" },
};

function drawPicture(context, camera, picture, spec) {
  const [x, y] = camera.toScreen(spec.origin[0], spec.origin[1] + spec.height * spec.resolution);
  context.imageSmoothingEnabled = camera.scale * spec.resolution < 1;
  context.drawImage(picture, x, y, spec.width * spec.resolution * camera.scale, spec.height * spec.resolution * camera.scale);
}

function drawGrid(context, camera, colours) {
  let step = 1;
  while (step * camera.scale < 24) step *= 5;
  const [x0, y1] = camera.toWorld(0, 0);
  const [x1, y0] = camera.toWorld(camera.width, camera.height);
  context.strokeStyle = colours["map-grid"];
  context.lineWidth = 1;
  context.beginPath();
  for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) {
    const [px] = camera.toScreen(x, 0);
    context.moveTo(Math.round(px) + 0.5, 0);
    context.lineTo(Math.round(px) + 0.5, camera.height);
  }
  for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) {
    const [, py] = camera.toScreen(0, y);
    context.moveTo(0, Math.round(py) + 0.5);
    context.lineTo(camera.width, Math.round(py) + 0.5);
  }
  context.stroke();
}

function drawTrail(context, camera, colours) {
  context.strokeStyle = colours.trail;
  context.lineWidth = 2;
  context.lineJoin = "round";
  context.setLineDash([1, 5]);
  context.lineCap = "round";
  context.beginPath();
  let pen = false;
  for (const place of store.trail) {
    if (!place) {
      pen = false;
      continue;
    }
    const at = camera.toScreen(place[0], place[1]);
    if (pen) context.lineTo(...at);
    else context.moveTo(...at);
    pen = true;
  }
  context.stroke();
  context.setLineDash([]);
}

function drawScan(context, camera, colours, scan) {
  const { at: [x, y, yaw], first, step, mm } = scan;
  const size = Math.min(5, Math.max(2, camera.scale * 0.03));
  context.fillStyle = colours.scan;
  for (let beam = 0; beam < mm.length; beam += 1) {
    if (!mm[beam]) continue;
    const angle = yaw + first + beam * step;
    const range = mm[beam] / 1000;
    const [px, py] = camera.toScreen(x + range * Math.cos(angle), y + range * Math.sin(angle));
    context.fillRect(px - size / 2, py - size / 2, size, size);
  }
}

/** Trajectory of the watched robot's plan that was driven to its end last. */
let over = null;
store.on("watch", () => { over = null; });

/** Whether a plan counts now: it is driven, or was just made. */
function isFresh(plan) {
  if (plan.points.length <= 5) return false;
  const driven = store.data("state")?.plan;
  if (driven?.finished) over = driven.trajectory_id;
  return plan.trajectory_id !== over && (driven?.trajectory_id === plan.trajectory_id || store.age("plan") < 3);
}

/** Whether the robot may no longer drive a plan. */
function isExpired(plan) {
  const driven = store.data("state")?.plan;
  return driven?.trajectory_id === plan.trajectory_id && driven.valid_for <= 0;
}

/** Whether a plan is drawn faintly: it may no longer be driven, or nobody knows. */
const isFaint = (plan) => isExpired(plan) || store.isStale();

/** Poses along a plan, at most `step` m apart, so that outlines drawn at them join. */
function posesAlong(plan, step) {
  const poses = [];
  plan.yaws.forEach((yaw, at) => {
    const [x, y] = [plan.points[at * 3], plan.points[at * 3 + 1]];
    const [fromX, fromY, fromYaw] = poses[poses.length - 1] ?? [x, y, yaw];
    const turn = Math.atan2(Math.sin(yaw - fromYaw), Math.cos(yaw - fromYaw));
    const parts = Math.ceil(Math.max(1, Math.hypot(x - fromX, y - fromY) / step, Math.abs(turn) / 0.2));
    for (let part = 1; part <= parts; part += 1) {
      const share = part / parts;
      poses.push([fromX + (x - fromX) * share, fromY + (y - fromY) * share, fromYaw + turn * share]);
    }
  });
  return poses;
}

/** The free polygons that the plan's curve stays in: where the robot's centre may be. */
function drawCorridor(context, camera, colours, corridor) {
  const plan = store.data("plan");
  if (!plan || plan.trajectory_id !== corridor.trajectory_id || !isFresh(plan)) return;
  const faint = isFaint(plan);
  context.fillStyle = colours.accent;
  context.strokeStyle = colours.accent;
  context.lineWidth = 1;
  // One shape, so that overlaps are no darker.
  context.beginPath();
  for (const polygon of corridor.polygons) {
    for (let at = 0; at + 1 < polygon.length; at += 2) {
      const place = camera.toScreen(polygon[at], polygon[at + 1]);
      if (at) context.lineTo(...place);
      else context.moveTo(...place);
    }
    context.closePath();
  }
  context.globalAlpha = faint ? 0.04 : 0.14;
  context.fill();
  context.globalAlpha = faint ? 0.2 : 0.6;
  context.stroke();
  context.globalAlpha = 1;
}

/** The floor that the footprint will sweep: its outline along the plan. */
function drawSwath(context, camera, colours, plan) {
  const outline = store.data("model")?.outline;
  if (!outline || plan.yaws.length === 0 || !isFresh(plan)) return;
  context.fillStyle = colours.good;
  context.globalAlpha = isFaint(plan) ? 0.06 : 0.16;
  context.beginPath();
  for (const [x, y, yaw] of posesAlong(plan, Math.max(0.03, 6 / camera.scale))) {
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    outline.forEach(([px, py], corner) => {
      const place = camera.toScreen(x + px * cos - py * sin, y + px * sin + py * cos);
      if (corner) context.lineTo(...place);
      else context.moveTo(...place);
    });
    context.closePath();
  }
  context.fill();
  context.globalAlpha = 1;
}

function drawPlan(context, camera, colours, plan) {
  const points = plan.points;
  if (!isFresh(plan)) return;
  const top = topOf(plan);
  context.globalAlpha = isFaint(plan) ? 0.3 : 1;
  context.lineCap = "round";
  context.lineJoin = "round";
  context.strokeStyle = colours["map-free"];
  context.lineWidth = 8;
  path(context, camera, points, 3);
  context.stroke();
  context.lineWidth = 4.5;
  const colourAt = (v) => Math.min(RAMP.length - 1, Math.floor((Math.abs(v) / top) * RAMP.length));
  for (let at = 0; at + 5 < points.length;) {
    const colour = colourAt(points[at + 2]);
    context.strokeStyle = RAMP[colour];
    context.beginPath();
    context.moveTo(...camera.toScreen(points[at], points[at + 1]));
    do {
      at += 3;
      context.lineTo(...camera.toScreen(points[at], points[at + 1]));
    } while (at + 5 < points.length && colourAt(points[at + 2]) === colour);
    context.stroke();
  }
  context.globalAlpha = 1;
}

function topOf(plan) {
  let top = 0.05;
  for (let at = 2; at < plan.points.length; at += 3) top = Math.max(top, Math.abs(plan.points[at]));
  return top;
}

/** The plan that shows with its greatest speed, m/s, or null. */
export function shownPlan() {
  const plan = store.data("plan");
  return layers.plan.on && plan && isFresh(plan) ? { ...plan, top: topOf(plan), expired: isExpired(plan) } : null;
}

function drawSearch(context, camera, colours, tree) {
  context.strokeStyle = colours.tree;
  context.globalAlpha = 0.55;
  context.lineWidth = 1;
  context.beginPath();
  for (let at = 0; at + 3 < tree.edges.length; at += 4) {
    context.moveTo(...camera.toScreen(tree.edges[at], tree.edges[at + 1]));
    context.lineTo(...camera.toScreen(tree.edges[at + 2], tree.edges[at + 3]));
  }
  context.stroke();
  context.globalAlpha = 1;
  context.lineWidth = 2;
  path(context, camera, tree.path);
  context.stroke();
}

/** What the certificate of a pose graph says, beside its first node. */
const CERTIFICATES = {
  pending: "proof pending", certified: "certified optimal", refused: "not certified", elsewhere: "not certified", unknown: "not certified",
};

/** What SLAM's map rests on: scans as dots; odometry, closures, and closures that are held to be false between them. */
function drawGraph(context, camera, colours, graph) {
  const at = (node) => camera.toScreen(graph.nodes[2 * node], graph.nodes[2 * node + 1]);
  const lines = (ends, colour, width, dash) => {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.beginPath();
    for (let end = 0; end + 1 < ends.length; end += 2) {
      context.moveTo(...at(ends[end]));
      context.lineTo(...at(ends[end + 1]));
    }
    context.stroke();
  };
  context.globalAlpha = 0.5;
  lines(graph.odometry, colours.soft, 1, []);
  context.globalAlpha = 1;
  lines(graph.closures, colours.good, 1.5, []);
  lines(graph.rejected, colours.bad, 1.5, [5, 4]);
  context.setLineDash([]);
  context.fillStyle = colours.soft;
  for (let node = 0; 2 * node + 1 < graph.nodes.length; node += 1) {
    const [x, y] = at(node);
    context.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  const verdict = CERTIFICATES[graph.certificate];
  if (verdict && graph.nodes.length > 1) {
    const [x, y] = at(0);
    label(context, colours, verdict, x + 6, y - 6, graph.certificate === "certified" ? colours.good : colours.soft);
  }
}

function drawMovers(context, camera, colours, movers) {
  context.strokeStyle = colours.mover;
  context.fillStyle = colours.mover;
  context.lineWidth = 2;
  for (const [x, y, vx, vy, radius] of movers) {
    const [px, py] = camera.toScreen(x, y);
    context.globalAlpha = 0.25;
    context.beginPath();
    context.arc(px, py, Math.max(4, radius * camera.scale), 0, TAU);
    context.fill();
    context.globalAlpha = 1;
    context.stroke();
    context.beginPath();
    context.moveTo(px, py);
    context.lineTo(...camera.toScreen(x + vx, y + vy));
    context.stroke();
  }
}

function drawMarkers(context, camera, colours) {
  context.strokeStyle = colours.marker;
  context.lineWidth = 1.5;
  for (const [name, { data }] of store.detail) {
    if (!name.startsWith("marker/") || store.age(name) > 3) continue;
    if (data.points.length === 1) {
      const [x, y] = camera.toScreen(...data.points[0]);
      context.beginPath();
      context.arc(x, y, 5, 0, TAU);
      context.stroke();
    } else if (data.points.length > 1) {
      path(context, camera, data.points.flat());
      context.stroke();
    }
  }
}

function drawZones(context, camera, colours, edited) {
  for (const zone of store.zones) {
    if (edited?.kind === "zone" && edited.original === zone.name) continue;
    drawZone(context, camera, colours, { ...zone, limit: zone.rule?.speed_limit?.max_speed ?? null });
  }
}

function drawPlaces(context, camera, colours, edited) {
  for (const [name, place] of Object.entries(store.places)) {
    if (edited?.kind === "place" && edited.original === name) continue;
    drawPlace(context, camera, colours, name, place);
  }
}

/** Where a goal leads: its own place, a named one, or that of the drive under way. */
export function placeOf(goal) {
  const { request } = goal;
  // Where it lies now: the map may have moved since it was sent.
  if (goal.resolved?.length === 1 && !request.waypoints?.length) return goal.resolved[0];
  if (Number.isFinite(request.x) && Number.isFinite(request.y)) return request;
  if (request.place && Object.hasOwn(store.places, request.place)) return store.places[request.place];
  const leg = [...(goal.legs ?? [])].reverse().find((one) => one.state === "Active" && one.goal);
  return leg?.goal ?? null;
}

function drawGoals(context, camera, colours) {
  for (const goal of store.goals.values()) {
    const open = goal.state === "Active" || goal.state === "Paused" || goal.state === "Accepted";
    const place = open ? placeOf(goal) : null;
    if (!place) continue;
    const waits = goal.state === "Accepted";
    drawGoal(context, camera, colours.goal, place, { dashed: waits, text: waits && goal.queue ? `${goal.queue}.` : "" }, colours);
    const given = goal.request.waypoints ?? [];
    const ways = goal.resolved?.length === given.length ? goal.resolved : given;
    for (const way of ways) drawGoal(context, camera, colours.goal, way, { dashed: true }, colours);
  }
}

function drawRobot(context, camera, colours, robot, pose, { colour, name, ghost = false }) {
  const outline = store.data("model", robot)?.outline;
  const [x, y] = camera.toScreen(pose.x, pose.y);
  context.save();
  context.translate(x, y);
  context.rotate(-pose.yaw);
  context.globalAlpha = ghost || store.isStale(robot) ? 0.4 : 1;
  context.fillStyle = colour;
  context.strokeStyle = colours["map-free"];
  context.lineWidth = 2;
  const size = camera.scale;
  context.beginPath();
  if (outline) for (const [px, py] of outline) context.lineTo(px * size, -py * size);
  else context.arc(0, 0, Math.max(8, 0.2 * size), 0, TAU);
  context.closePath();
  context.globalAlpha *= 0.85;
  context.fill();
  context.stroke();
  const reach = Math.max(8, (outline ? Math.max(...outline.map(([px]) => px)) : 0.2) * size);
  context.globalAlpha = store.isStale(robot) ? 0.5 : 1;
  context.fillStyle = "#fff";
  context.beginPath();
  context.moveTo(reach * 0.75, 0);
  context.lineTo(-reach * 0.35, reach * 0.5);
  context.lineTo(-reach * 0.12, 0);
  context.lineTo(-reach * 0.35, -reach * 0.5);
  context.closePath();
  context.fill();
  context.restore();
  if (name) label(context, colours, robot, x + 0.75 * reach + 4, y - 0.75 * reach, colour);
}

export function drawAll(context, camera, colours, { pose, poseOf, tools }) {
  context.fillStyle = colours["map-unknown"];
  context.fillRect(0, 0, camera.width, camera.height);
  const on = (name) => layers[name].on;
  if (store.raster.spec) {
    context.globalAlpha = store.isMapOld() || store.socket !== "open" ? 0.5 : 1;
    if (on("map")) drawPicture(context, camera, store.raster.canvas, store.raster.spec);
    if (on("clearance")) {
      const { picture, spec } = store.raster.clearancePicture();
      drawPicture(context, camera, picture, spec);
    }
    context.globalAlpha = 1;
  }
  if (on("grid")) drawGrid(context, camera, colours);
  const detail = (name, draw) => {
    const entry = store.detail.get(name);
    if (entry) draw(context, camera, colours, entry.data);
  };
  if (on("tree") && store.age("tree") < 20) detail("tree", drawSearch);
  if (on("graph")) detail("graph", drawGraph);
  if (on("trail")) drawTrail(context, camera, colours);
  if (on("corridor")) detail("corridor", drawCorridor);
  if (on("swath")) detail("plan", drawSwath);
  if (on("plan")) detail("plan", drawPlan);
  const edited = tools.draft;
  if (on("zones")) drawZones(context, camera, colours, edited);
  if (on("goals")) drawGoals(context, camera, colours);
  if (on("places")) drawPlaces(context, camera, colours, edited);
  if (on("scan")) {
    for (const name of store.detail.keys()) {
      if (!name.startsWith("scan")) continue;
      context.globalAlpha = store.age(name) > 1.5 ? 0.25 : 1;
      detail(name, drawScan);
      context.globalAlpha = 1;
    }
  }
  if (on("obstacles") && store.age("obstacles") < 1) detail("obstacles", drawMovers);
  if (on("markers")) drawMarkers(context, camera, colours);
  if (on("robots")) {
    for (const robot of store.fleet) {
      const other = robot === store.watched ? null : poseOf(robot);
      if (other) drawRobot(context, camera, colours, robot, other, { colour: colours.other, name: true });
    }
  }
  // Where a robot that does not know its place may be.
  const health = store.data("localisation")?.health;
  if (health?.state === "ambiguous") {
    for (const place of health.hypotheses) drawRobot(context, camera, colours, store.watched, place, { colour: colours.bad, ghost: true });
  }
  if (pose) drawRobot(context, camera, colours, store.watched, pose, { colour: colours.robot, name: store.fleet.length > 1 });
  if (edited) drawDraft(context, camera, colours, edited, tools.corner);
  if (tools.measure) drawMeasure(context, camera, colours, tools.measure);
}

/** What waits to be confirmed; the corners of a zone can be taken hold of. */
function drawDraft(context, camera, colours, draft, held) {
  if (draft.kind === "goal") drawGoal(context, camera, colours.goal, draft, { dashed: true }, colours);
  if (draft.kind === "place") drawGoal(context, camera, colours.place, draft, { dashed: true, text: draft.name ?? "" }, colours);
  if (draft.kind === "pose") {
    drawGoal(context, camera, colours.robot, draft, { dashed: true }, colours);
    if (draft.yaw !== null) drawRobot(context, camera, colours, store.watched, draft, { colour: colours.robot, ghost: true });
  }
  if (draft.kind !== "zone" || !draft.points.length) return;
  drawZone(context, camera, colours, { ...draft, name: "" });
  context.fillStyle = colours.panel;
  context.lineWidth = 2;
  draft.points.forEach((point, index) => {
    const [x, y] = camera.toScreen(...point);
    context.strokeStyle = index === held ? colours.accent : colours.text;
    context.beginPath();
    context.arc(x, y, index === held ? 8 : 6, 0, TAU);
    context.fill();
    context.stroke();
  });
}

function drawMeasure(context, camera, colours, [from, to]) {
  const [a, b] = [camera.toScreen(...from), camera.toScreen(...to)];
  context.strokeStyle = colours.text;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(...a);
  context.lineTo(...b);
  context.stroke();
  for (const [x, y] of [a, b]) {
    context.beginPath();
    context.arc(x, y, 4, 0, TAU);
    context.fillStyle = colours.text;
    context.fill();
  }
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  const angle = degrees(Math.atan2(to[1] - from[1], to[0] - from[0]));
  label(context, colours, `${length.toFixed(3)} m, ${angle}°`, (a[0] + b[0]) / 2 + 10, (a[1] + b[1]) / 2 - 8, colours.text);
}
