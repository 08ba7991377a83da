// Plots. How does a number of the robot change over time? Any numeric field of what the page hears, over the last minute.

import { $, el, setText } from "./dom.js";
import { recallJson, remember } from "./memory.js";
import { store } from "./store.js";

/** Time shown, s. */
const SPAN = 60;
/** A longer time without a value is a gap in the line, s. */
const GAP = 2;
/** Units of fields, by the last part of their path. */
const UNITS = {
  x: "m", y: "m", yaw: "rad", sd: "m", v: "m/s", w: "rad/s", distance_left: "m", length: "m", min_clearance: "m", corridor_width: "m",
  time: "s", time_left: "s", valid_for: "s", duration: "s", round_trip_secs: "s", p50_ms: "ms", p95_ms: "ms",
};
const MAX_POINTS = 1200;
const KEPT = "zenav-plots";
let plots = [];
let select = null;

/** Channels that the map draws: their numbers are places. */
const DRAWN = /^(scan|marker)(\/|$)|^annotations$/;

/** Numeric fields of a message, as paths: `pose.v`, `state.plan.distance_left`. */
function fieldsOf(value, path, found) {
  if (typeof value === "number") found.push(path);
  else if (value && typeof value === "object" && !Array.isArray(value)) {
    for (const [key, inner] of Object.entries(value)) fieldsOf(inner, `${path}.${key}`, found);
  }
}

/** A number of four digits, and no more of them than it needs. */
const short = (value) => String(Number(value.toPrecision(4)));

/** A path with its unit. */
function nameOf(path) {
  const unit = UNITS[path.split(".").pop()];
  return unit ? `${path}, ${unit}` : path;
}

function allFields() {
  const found = [];
  for (const name of store.channels()) if (!DRAWN.test(name)) fieldsOf(store.data(name), name, found);
  return found.filter((path) => !/stamp|boot|incarnation|trajectory_id/.test(path));
}

function valueOf(path) {
  const [channel, ...rest] = path.split(".");
  let value = store.data(channel);
  for (const key of rest) value = value?.[key];
  return typeof value === "number" ? value : null;
}

function add(path) {
  if (!path || plots.some((plot) => plot.path === path)) return;
  const canvas = el("canvas", { role: "img" });
  const text = el("b");
  const remove = el("button", { type: "button", "aria-label": `Remove ${path}`, onclick: () => {
    plots = plots.filter((plot) => plot.path !== path);
    figure.remove();
    keep();
  } }, "×");
  const figure = el("figure", { class: "plot" }, el("figcaption", {}, el("span", {}, nameOf(path)), text, remove), canvas);
  $("panel-plots").append(figure);
  plots.push({ path, canvas, text, points: [] });
  keep();
}

function keep() {
  remember(KEPT, JSON.stringify(plots.map((plot) => plot.path)));
}

/** Takes the values of now; those of a robot that is silent are of the past, and no values of now. */
function sample() {
  const now = performance.now() / 1000;
  const isOld = store.isStale();
  for (const plot of plots) {
    const value = isOld ? null : valueOf(plot.path);
    if (value !== null) plot.points.push([now, value]);
    while (plot.points.length > MAX_POINTS || now - plot.points[0]?.[0] > SPAN) plot.points.shift();
  }
  if (!$("panel-plots").hidden) draw(now);
}

function draw(now) {
  const style = getComputedStyle(document.documentElement);
  for (const { canvas, text, points, path } of plots) {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) continue;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    if (!points.length) {
      setText(text, "");
      canvas.setAttribute("aria-label", `${nameOf(path)}: no value in the last minute`);
      continue;
    }
    let [low, high] = [Infinity, -Infinity];
    for (const [, value] of points) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    const [at, last] = points[points.length - 1];
    const isOld = now - at > GAP;
    setText(text, isOld ? "" : short(last));
    canvas.setAttribute("aria-label", `${nameOf(path)}: ${isOld ? "last" : "now"} ${short(last)}, between ${short(low)} and ${short(high)} in the last minute`);
    // A constant is a line in the middle.
    const pad = high - low < 1e-3 ? Math.max(0.005 * Math.abs(high), 5e-4) : 0;
    [low, high] = [low - pad, high + pad];
    const y = (value) => height - 8 - ((value - low) / (high - low)) * (height - 22);
    const x = (time) => width - ((now - time) / SPAN) * width;
    context.font = "10px system-ui, 'DejaVu Sans', sans-serif";
    context.fillStyle = style.getPropertyValue("--soft");
    context.fillText(short(high), 4, 11);
    context.fillText(short(low), 4, height - 3);
    context.textAlign = "right";
    context.fillText(`last ${SPAN} s`, width - 4, 11);
    if (low < 0 && high > 0) {
      context.strokeStyle = style.getPropertyValue("--line");
      context.beginPath();
      context.moveTo(0, y(0));
      context.lineTo(width, y(0));
      context.stroke();
    }
    context.strokeStyle = style.getPropertyValue("--accent");
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    context.beginPath();
    let before = -Infinity;
    for (const [time, value] of points) {
      if (time - before > GAP) context.moveTo(x(time), y(value));
      else context.lineTo(x(time), y(value));
      before = time;
    }
    context.stroke();
  }
}

export function startPlots() {
  select = el("select", { "aria-label": "Field to plot" });
  const fill = () => {
    const fields = allFields();
    if (fields.join() === [...select.options].map((option) => option.value).join()) return;
    const chosen = select.value;
    select.replaceChildren(...fields.map((path) => el("option", { value: path }, nameOf(path))));
    if (fields.includes(chosen)) select.value = chosen;
  };
  const row = el("div", { class: "row" }, el("label", { class: "grow" }, "Field", select),
    el("button", { type: "button", onclick: () => add(select.value) }, "Plot"));
  select.addEventListener("focus", fill);
  $("panel-plots").append(row, el("p"));
  const kept = recallJson(KEPT, null);
  const paths = Array.isArray(kept) ? kept : ["pose.v", "pose.w", "state.battery"];
  paths.filter((path) => typeof path === "string").slice(0, 8).forEach(add);
  store.on("frame", () => {
    sample();
    if (select.options.length < 3) fill();
  });
  // No frames come while the gateway is away, but time passes.
  setInterval(() => {
    if (store.socket !== "open") sample();
  }, 1000);
  store.on("watch", () => plots.forEach((plot) => { plot.points = []; }));
}
