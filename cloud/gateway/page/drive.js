// Hand control. How is a robot driven from the page? Armed by its name, a key held, and rest as soon as it is not.
//
// The command is repeated while a key is held; the gateway lets it act for 0.3 s, and the robot has a dead man's switch of its own.

import { $, ask, el, isTyping, setText, toast } from "./dom.js";
import { send } from "./live.js";
import { store } from "./store.js";

/** While a key is held, a command goes out this often, ms. */
const PERIOD_MS = 50;
const KEYS = {
  w: [1, 0], s: [-1, 0], a: [0, 1], d: [0, -1], q: [1, 0.6], e: [1, -0.6],
  arrowup: [1, 0], arrowdown: [-1, 0], arrowleft: [0, 1], arrowright: [0, -1],
};
const held = new Map();
let share = 0.4;
let parts = null;

const isArmed = () => store.teleop.state === "armed" && store.teleop.robot === store.watched;
/** Whether keys drive the robot now. */
export const drives = isArmed;

function command() {
  let [forward, left] = [0, 0];
  for (const [v, w] of held.values()) {
    forward += v;
    left += w;
  }
  const model = store.data("model") ?? { max_v: 0.3, max_w: 1 };
  const limit = (value) => Math.max(-1, Math.min(1, value));
  // Backwards the wheel turns the other way, as in a car.
  return { v: limit(forward) * model.max_v * share, w: limit(left) * model.max_w * share };
}

let rested = true;
function beat() {
  if (!isArmed()) return;
  if (held.size === 0 && rested) return;
  rested = held.size === 0;
  send({ type: "drive", ...command(), sent: store.gatewayTime() });
}

function letGo() {
  held.clear();
  beat();
  parts?.pad.querySelectorAll(".held").forEach((button) => button.classList.remove("held"));
}

async function arm() {
  const robot = store.watched;
  const name = await ask({
    title: "Drive by hand", text: `This takes control of ${robot} from its mission and drops its plan. Type the robot's name to arm.`,
    yes: "Arm", field: "Name of the robot", wanted: robot,
  });
  if (name === robot && store.watched === robot) send({ type: "arm", robot });
}

function disarm() {
  letGo();
  send({ type: "disarm" });
}

function padButton(text, label, move) {
  const button = el("button", { type: "button", "aria-label": label }, text);
  const press = (event) => {
    event.preventDefault();
    button.setPointerCapture?.(event.pointerId);
    button.classList.add("held");
    held.set(button, move);
    beat();
  };
  const release = () => {
    button.classList.remove("held");
    held.delete(button);
    beat();
  };
  button.addEventListener("pointerdown", press);
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(end, release);
  button.addEventListener("keydown", (event) => {
    if ((event.key === "Enter" || event.key === " ") && !event.repeat) held.set(button, move), button.classList.add("held"), beat();
  });
  button.addEventListener("keyup", release);
  button.addEventListener("blur", release);
  return button;
}

function build() {
  const panel = $("panel-drive");
  const note = el("p", { class: "armed-note" });
  const pad = el("div", { class: "pad", role: "group", "aria-label": "Drive" },
    padButton("↖", "Forwards and left", [1, 0.6]), padButton("↑", "Forwards", [1, 0]), padButton("↗", "Forwards and right", [1, -0.6]),
    padButton("↶", "Turn left", [0, 1]), el("span"), padButton("↷", "Turn right", [0, -1]),
    el("span"), padButton("↓", "Backwards", [-1, 0]), el("span"));
  const slider = el("input", { type: "range", min: "0.1", max: "1", step: "0.05", value: String(share), oninput: () => { share = slider.valueAsNumber; draw(); } });
  const limit = el("label", {}, el("span"), slider);
  const button = el("button", { type: "button" });
  const help = el("p", { class: "quiet-text" },
    "Takes the operator's lease: the mission waits, and gets the robot back when you release it. Hold W A S D, Q E, the arrows or a button to drive; "
    + "let go to stop. If this page is lost while it is armed, the robot is stopped.");
  panel.append(note, button, pad, limit, help);
  parts = { note, pad, limit, button };
}

function draw() {
  const armed = isArmed();
  $("stage").classList.toggle("armed", armed);
  $("panels").classList.toggle("driving", armed);
  parts.note.hidden = parts.pad.hidden = parts.limit.hidden = !armed;
  setText(parts.note, `Armed: keys drive ${store.watched}`);
  const model = store.data("model") ?? { max_v: 0.3, max_w: 1 };
  setText(parts.limit.firstChild, `Speed up to ${(model.max_v * share).toFixed(2)} m/s, ${(model.max_w * share).toFixed(2)} rad/s`);
  setText(parts.button, armed ? "Release control" : "Take control…");
  parts.button.onclick = armed ? disarm : arm;
  parts.button.className = armed ? "" : "primary";
  parts.button.disabled = !store.watched;
}

export function startDrive() {
  build();
  draw();
  store.on("teleop", () => {
    const { state, reason, robot } = store.teleop;
    if (state === "refused") toast(`No control of ${robot}: ${reason}`, "bad");
    if (state === "released") letGo(), toast(reason ? `Control released: ${reason}` : "Control released");
    // Another robot was chosen while this one was asked.
    if (state === "armed" && robot !== store.watched) disarm();
    draw();
  });
  store.on("watch", () => {
    if (store.teleop.state === "armed" && store.teleop.robot !== store.watched) disarm();
    draw();
  });
  store.on("socket", () => {
    if (store.socket === "open") return;
    store.teleop = { state: "released" };
    letGo();
    draw();
  });
  window.addEventListener("keydown", (event) => {
    // With these held, some systems do not tell when another key is let go.
    if (event.metaKey || event.ctrlKey || event.altKey) letGo();
    const move = KEYS[event.key.toLowerCase()];
    if (!move || !isArmed() || isTyping(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    held.set(event.code, move);
    if (!event.repeat) beat();
  });
  window.addEventListener("keyup", (event) => {
    if (held.delete(event.code)) beat();
  });
  // A menu or a list that opens takes the keys; a finger that stays on a key of the page asks for none.
  window.addEventListener("contextmenu", (event) => {
    if (event.target.closest?.(".pad")) event.preventDefault();
    else letGo();
  });
  window.addEventListener("focusin", (event) => { if (isTyping({ target: event.target, key: "" })) letGo(); });
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });
  setInterval(beat, PERIOD_MS);
}
