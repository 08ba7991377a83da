// Plots. How does a number of the robot change over time? Any numeric field of what the page hears, over the last minute.

import { $, el, setText } from "./dom.js";
import { store } from "./store.js";

const SPAN = 60;
const MAX_POINTS = 1200;
const KEPT = "zenav-plots";
let plots = [];
let select = null;

/** Numeric fields of a message, as paths: `pose.v`, `state.plan.distance_left`. */
function fieldsOf(value, path, found) {
  if (typeof value === "number") found.push(path);
  else if (value && typeof value === "object" && !Array.isArray(value)) {
    for (const [key, inner] of Object.entries(value)) fieldsOf(inner, `${path}.${key}`, found);
  }
}

function allFields() {
  const found = [];
  for (const name of ["pose", "state", "plan", "round_trip", "mission"]) {
    const data = store.data(name);
    if (name === "mission") fieldsOf(data?.feedback, "mission.feedback", found);
    else fieldsOf(data, name, found);
  }
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
  const text = el("span");
  const remove = el("button", { type: "button", "aria-label": `Remove ${path}`, onclick: () => {
    plots = plots.filter((plot) => plot.path !== path);
    figure.remove();
    keep();
  } }, "×");
  const figure = el("figure", { class: "plot" }, el("figcaption", {}, el("span", {}, path), text, remove), canvas);
  $("panel-plots").append(figure);
  plots.push({ path, canvas, text, points: [] });
  keep();
}

function keep() {
  localStorage.setItem(KEPT, JSON.stringify(plots.map((plot) => plot.path)));
}

function sample() {
  const now = performance.now() / 1000;
  for (const plot of plots) {
    const value = valueOf(plot.path);
    if (value === null) continue;
    plot.points.push([now, value]);
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
    if (!points.length) continue;
    let [low, high] = [Infinity, -Infinity];
    for (const [, value] of points) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    const last = points[points.length - 1][1];
    setText(text, `${last.toPrecision(4)}`);
    canvas.setAttribute("aria-label", `${path}: now ${last.toPrecision(3)}, between ${low.toPrecision(3)} and ${high.toPrecision(3)} in the last minute`);
    const room = Math.max(high - low, Math.abs(high) * 0.01, 1e-6);
    const y = (value) => height - 8 - ((value - low) / room) * (height - 22);
    const x = (time) => width - ((now - time) / SPAN) * width;
    context.font = "10px system-ui, 'DejaVu Sans', sans-serif";
    context.fillStyle = style.getPropertyValue("--soft");
    context.fillText(high.toPrecision(3), 4, 11);
    context.fillText(low.toPrecision(3), 4, height - 3);
    context.strokeStyle = style.getPropertyValue("--accent");
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    context.beginPath();
    for (const [time, value] of points) context.lineTo(x(time), y(value));
    context.stroke();
  }
}

export function startPlots() {
  select = el("select", { "aria-label": "Field to plot" });
  const fill = () => {
    const fields = allFields();
    if (fields.length === select.options.length) return;
    const chosen = select.value;
    select.replaceChildren(...fields.map((path) => el("option", { value: path }, path)));
    if (fields.includes(chosen)) select.value = chosen;
  };
  const row = el("div", { class: "row" }, el("label", { class: "grow" }, "Field of the last minute", select),
    el("button", { type: "button", onclick: () => add(select.value) }, "Plot"));
  select.addEventListener("focus", fill);
  $("panel-plots").append(row, el("p"));
  let kept = ["pose.v", "pose.w", "state.battery"];
  try {
    kept = JSON.parse(localStorage.getItem(KEPT)) ?? kept;
  } catch {
    // What cannot be read is forgotten.
  }
  kept.filter((path) => typeof path === "string").slice(0, 8).forEach(add);
  store.on("frame", () => {
    sample();
    if (select.options.length < 3) fill();
  });
  store.on("watch", () => plots.forEach((plot) => { plot.points = []; }));
}
