// Map view. When is the map drawn, and what does the pointer do? At most once a screen frame, and only when something changed.

import { Camera } from "./camera.js";
import { $ } from "./dom.js";
import { drawAll, layers } from "./layers.js";
import { store } from "./store.js";
import { tools } from "./tools.js";

/** Frames come this often, s: the pose is drawn between the last two, so that it moves smoothly. */
const BETWEEN = 0.1;

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
    "scan", "trail", "robot", "other", "goal", "place", "tree", "mover"];
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
  if (Math.hypot(b.x - a.x, b.y - a.y) > 0.5) return b;
  const turn = Math.atan2(Math.sin(b.yaw - a.yaw), Math.cos(b.yaw - a.yaw));
  if (share < 1) redraw();
  return { ...b, x: a.x + (b.x - a.x) * share, y: a.y + (b.y - a.y) * share, yaw: a.yaw + turn * share };
}

function resize() {
  const { clientWidth, clientHeight } = canvas;
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(clientWidth * ratio);
  canvas.height = Math.round(clientHeight * ratio);
  camera.width = clientWidth;
  camera.height = clientHeight;
  redraw();
}

/** The whole map, the robot and its goal. */
export function fit() {
  const extent = store.raster.known();
  const pose = store.data("pose");
  if (extent) {
    if (pose) {
      extent[0] = Math.min(extent[0], pose.x - 0.5);
      extent[1] = Math.min(extent[1], pose.y - 0.5);
      extent[2] = Math.max(extent[2], pose.x + 0.5);
      extent[3] = Math.max(extent[3], pose.y + 0.5);
    }
    camera.fit(extent);
  } else if (pose) {
    camera.fit([pose.x - 3, pose.y - 3, pose.x + 3, pose.y + 3]);
  }
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
  if (!dirty || !camera.width) return;
  dirty = false;
  const pose = poseOf(store.watched);
  if (following && pose) {
    const share = 0.15;
    camera.x += (pose.x - camera.x) * share;
    camera.y += (pose.y - camera.y) * share;
    if (Math.hypot(pose.x - camera.x, pose.y - camera.y) * camera.scale > 0.5) dirty = true;
  }
  const ratio = window.devicePixelRatio || 1;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawAll(context, camera, colours, { pose, poseOf, tools });
  drawScale();
  view.drawn += 1;
}

/** Counters for tests and for those who look closely. */
export const view = { drawn: 0, camera, layers };

function pointerText(event) {
  const [x, y] = camera.toWorld(event.offsetX, event.offsetY);
  $("pointer").textContent = `${x.toFixed(2)}, ${y.toFixed(2)} m`;
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
    pointerText(event);
    const before = pointers.get(event.pointerId);
    if (!before) return;
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
    redraw();
  });
  const up = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    if (!panning && pointers.size === 0 && event.type === "pointerup") tools.up(camera.toWorld(event.offsetX, event.offsetY));
    redraw();
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("pointerleave", () => { $("pointer").textContent = ""; });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    camera.zoomAt(event.offsetX, event.offsetY, Math.exp(-event.deltaY * lines * 0.0015));
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
