// Map view. When is the map drawn, and what does the pointer do? At most once a screen frame, and only when something changed.

import { Camera } from "./camera.js";
import { $, degrees } from "./dom.js";
import { drawAll, layers, placeOf } from "./layers.js";
import { store } from "./store.js";
import { tools } from "./tools.js";

/** Frames come this often, s: the pose is drawn between the last two, so that it moves smoothly. */
const BETWEEN = 0.1;

/** Most that one turn of the wheel zooms, as a logarithm: there are wheels that spin freely. */
const FASTEST = 0.5;
/** A smaller change of the pose is rest, m and rad: poses are told to the millimetre. */
const STILL = 0.0015;

export const camera = new Camera();
const canvas = $("map");
const context = canvas.getContext("2d");
let dirty = true;
let following = false;
let fitted = false;
let colours = {};

export function redraw() {
  dirty = true;
}

export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["ground", "panel", "line", "text", "soft", "accent", "good", "warn", "bad", "map-unknown", "map-free", "map-wall", "map-grid",
    "scan", "trail", "robot", "other", "goal", "place", "tree", "mover", "marker"];
  colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  store.raster.setColours({ unknown: colours["map-unknown"], free: colours["map-free"], wall: colours["map-wall"] });
  redraw();
}

/** A robot's pose now, between the last two that were heard. */
export function poseOf(robot) {
  const channels = store.robots.get(robot);
  const last = channels?.pose;
  if (!last) return null;
  const before = channels.before;
  const now = performance.now() / 1000;
  if (!before || last.heard - before.heard > 1) return last.data;
  const share = Math.min(1, Math.max(0, (now - last.heard) / Math.max(BETWEEN, last.heard - before.heard)));
  const [a, b] = [before.data, last.data];
  const [way, turn] = [Math.hypot(b.x - a.x, b.y - a.y), Math.atan2(Math.sin(b.yaw - a.yaw), Math.cos(b.yaw - a.yaw))];
  // A jump is no motion, and what rests needs no screen frames in between.
  if (way > 0.5 || way < STILL && Math.abs(turn) < STILL) return b;
  if (share < 1) redraw();
  return { ...b, x: a.x + (b.x - a.x) * share, y: a.y + (b.y - a.y) * share, yaw: a.yaw + turn * share };
}

/** Pixels of the screen in one of the page; a window that moves to another screen changes it, and nothing else. */
const pixelRatio = () => window.devicePixelRatio || 1;
let drawnRatio = 0;

function resize() {
  const { clientWidth, clientHeight } = canvas;
  const ratio = pixelRatio();
  drawnRatio = ratio;
  canvas.width = Math.round(clientWidth * ratio);
  canvas.height = Math.round(clientHeight * ratio);
  camera.width = clientWidth;
  camera.height = clientHeight;
  redraw();
}

/** The whole map, the robot and where it is sent. */
export function fit() {
  const pose = store.data("pose");
  const extent = store.raster.known() ?? (pose ? [pose.x - 3, pose.y - 3, pose.x + 3, pose.y + 3] : null);
  if (!extent) return;
  const goal = store.runningGoal();
  for (const place of [pose, goal ? placeOf(goal) : null]) {
    if (!place) continue;
    extent[0] = Math.min(extent[0], place.x - 0.5);
    extent[1] = Math.min(extent[1], place.y - 0.5);
    extent[2] = Math.max(extent[2], place.x + 0.5);
    extent[3] = Math.max(extent[3], place.y + 0.5);
  }
  camera.fit(extent);
  redraw();
}

export function setFollow(on) {
  following = on;
  $("follow").setAttribute("aria-pressed", String(on));
  redraw();
}

function drawScale() {
  const length = camera.rule();
  const bar = $("scale");
  bar.style.width = `${length * camera.scale}px`;
  bar.firstElementChild.textContent = length >= 1 ? `${length} m` : `${Math.round(length * 100)} cm`;
}

function tick() {
  requestAnimationFrame(tick);
  if (pixelRatio() !== drawnRatio) resize();
  if (!dirty || !camera.width) return;
  dirty = false;
  const pose = poseOf(store.watched);
  if (following && pose) {
    const share = 0.15;
    camera.x += (pose.x - camera.x) * share;
    camera.y += (pose.y - camera.y) * share;
    if (Math.hypot(pose.x - camera.x, pose.y - camera.y) * camera.scale > 0.5) dirty = true;
  }
  context.setTransform(drawnRatio, 0, 0, drawnRatio, 0, 0);
  drawAll(context, camera, colours, { pose, poseOf, tools });
  drawScale();
  view.drawn += 1;
}

/** For tests, and for those who look closely. */
export const view = { drawn: 0, camera, layers, redraw };

function pointerText(event) {
  const [x, y] = camera.toWorld(event.offsetX, event.offsetY);
  $("pointer").textContent = tools.heading === null ? `pointer ${x.toFixed(2)}, ${y.toFixed(2)} m` : `heading ${degrees(tools.heading)}°`;
}

function startPointers() {
  const pointers = new Map();
  let panning = false;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    panning = event.button !== 0 || event.shiftKey || tools.current === "pan" || pointers.size > 1;
    if (pointers.size > 1) tools.abort();
    if (!panning) tools.down(camera.toWorld(event.offsetX, event.offsetY), camera.scale);
    redraw();
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) {
      pointerText(event);
      return;
    }
    const here = [event.offsetX, event.offsetY];
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const span = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
      camera.zoomAt((here[0] + other[0]) / 2, (here[1] + other[1]) / 2, span(here, other) / Math.max(1, span(before, other)));
      camera.pan((here[0] - before[0]) / 2, (here[1] - before[1]) / 2);
      setFollow(false);
    } else if (panning) {
      camera.pan(here[0] - before[0], here[1] - before[1]);
      if (following) setFollow(false);
    } else {
      tools.move(camera.toWorld(...here), camera.scale);
    }
    pointers.set(event.pointerId, here);
    pointerText(event);
    redraw();
  });
  const up = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    // A finger touches a map also to move it, so what it set is confirmed first.
    if (!panning && event.type === "pointerup") tools.up(event.pointerType === "touch");
    else tools.abort();
    pointerText(event);
    redraw();
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("pointerleave", () => { $("pointer").textContent = ""; });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const unit = [1, 16, camera.height][event.deltaMode] ?? 1;
    // Two fingers that spread on a trackpad come as a wheel with Ctrl, in far smaller steps.
    const speed = event.ctrlKey ? 0.01 : 0.0015;
    const step = Math.max(-FASTEST, Math.min(FASTEST, -event.deltaY * unit * speed));
    camera.zoomAt(event.offsetX, event.offsetY, Math.exp(step));
    redraw();
  }, { passive: false });
}

export function zoom(factor) {
  camera.zoomAt(camera.width / 2, camera.height / 2, factor);
  redraw();
}

export function panKeys(event) {
  const step = 60;
  const by = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
  if (!by) return false;
  camera.pan(...by);
  setFollow(false);
  return true;
}

export function startView() {
  new ResizeObserver(resize).observe(canvas);
  resize();
  readColours();
  startPointers();
  store.on("frame", redraw);
  store.on("map", () => {
    if (!fitted && store.raster.known()) {
      fitted = true;
      fit();
    }
    redraw();
  });
  store.on("watch", () => { fitted = false; });
  tools.onchange = redraw;
  requestAnimationFrame(tick);
}
