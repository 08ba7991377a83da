// Goals. Which run, wait, and have ended, and why?

import { cancelGoal, listGoals, moveGoal, pauseGoal, resumeGoal } from "./api.js";
import { $, byName, degrees, duration, el, radians, refill, setText, toast } from "./dom.js";
import { attempt, sendGoal } from "./send.js";
import { store } from "./store.js";

const SHOWN = 30;
const SIGNS = {
  Accepted: ["…", "goal-text"], Succeeded: ["✓", "good-text"], Aborted: ["✗", "bad-text"], Canceled: ["–", "soft-text"], Rejected: ["✗", "bad-text"],
};
/** How the end of a goal is told, and as what kind of note. */
const ENDS = { Succeeded: ["reached", "good"], Aborted: ["failed", "bad"], Canceled: ["cancelled", ""] };
let drawn = "";
let again;
/** Robots and goals whose end was not seen yet. It outlasts the list of goals, which begins anew after a lost link. */
const open = new Set();

export function titleOf(goal) {
  const { request } = goal;
  if (request.place) return request.place;
  if (Number.isFinite(request.x)) {
    const heading = Number.isFinite(request.yaw) ? `, ${degrees(request.yaw)}°` : "";
    return `${request.x.toFixed(2)}, ${request.y.toFixed(2)}${heading}`;
  }
  if (request.waypoints?.length) return `${request.waypoints.length} waypoints`;
  const tree = request.tree ?? "tree";
  return tree.length < 40 ? tree : "tree sent with the goal";
}

function seconds(from, to) {
  return (to - from) / 1e9;
}

function outcomeOf(goal) {
  const took = goal.started && goal.ended ? `${duration(seconds(goal.started, goal.ended))}` : "";
  const plans = goal.feedback?.plans ? `${goal.feedback.plans} ${goal.feedback.plans === 1 ? "plan" : "plans"}` : "";
  return [goal.reason, goal.state === "Accepted" ? "queued" : took, plans].filter(Boolean).join(" · ");
}

/** Goals that wait, the next one first. */
function queue() {
  const waiting = [...store.goals.values()].filter((goal) => goal.state === "Accepted");
  return waiting.sort((a, b) => (a.queue ?? Infinity) - (b.queue ?? Infinity) || a.accepted - b.accepted);
}

/** Moves a waiting goal to a place in the queue, counted without it. */
function moveTo(id, place) {
  const others = queue().filter((goal) => goal.id !== id);
  return attempt("Not moved", () => moveGoal(store.watched, id, others[place]?.id));
}

function control(text, name, goal, onclick, disabled = false) {
  return el("button", { type: "button", title: name, "aria-label": `${name}: goal ${titleOf(goal)}`, onclick, disabled }, text);
}

/** Buttons of a goal that waits, in its place of so many. */
function controls(goal, place, count) {
  return el("span", { class: "controls" },
    control("↑", "Earlier", goal, () => moveTo(goal.id, place - 1), place === 0),
    control("↓", "Later", goal, () => moveTo(goal.id, place + 1), place === count - 1),
    control("Cancel", "Cancel", goal, () => attempt("Not cancelled", () => cancelGoal(store.watched, goal.id))));
}

/** A waiting goal can be dragged onto another one: it is put before it, or after it where it comes from above. */
function makeDraggable(item, goal, place) {
  item.draggable = true;
  item.addEventListener("dragstart", (event) => event.dataTransfer.setData("text/goal", goal.id));
  item.addEventListener("dragover", (event) => {
    if (event.dataTransfer.types.includes("text/goal")) event.preventDefault();
  });
  item.addEventListener("drop", (event) => {
    event.preventDefault();
    const id = event.dataTransfer.getData("text/goal");
    if (id && id !== goal.id) moveTo(id, place);
  });
}

function row(goal, place, count) {
  const [sign, kind] = SIGNS[goal.state] ?? ["", ""];
  const waits = goal.state === "Accepted";
  const item = el("li", { title: goal.id, class: waits ? "waits" : "" },
    el("span", { class: kind, "aria-label": waits ? `Queued, place ${place + 1}` : goal.state, role: "img" }, waits ? `${place + 1}.` : sign),
    el("span", {}, titleOf(goal), el("small", {}, outcomeOf(goal))), waits ? controls(goal, place, count) : null);
  if (waits) makeDraggable(item, goal, place);
  return item;
}

/** The running goal: its card is made once, and then only changed. */
function drawActive(goal) {
  const box = $("active-goal");
  if (!goal) {
    box.replaceChildren();
    return;
  }
  let card = box.firstChild;
  if (card?.dataset.id !== goal.id) {
    card = el("div", { class: "card", "data-id": goal.id },
      el("h3", {}, el("span"), el("small", { class: "soft-text" })), el("p"), el("progress", { max: 1, "aria-label": "Progress" }),
      el("div", { class: "row" },
        el("button", { type: "button", class: "pause" }), el("button", { type: "button", onclick: () => attempt("Not cancelled", () => cancelGoal(store.watched, goal.id)) }, "Cancel goal")));
    card.most = 0;
    box.replaceChildren(card);
  }
  const paused = goal.state === "Paused";
  card.classList.toggle("paused", paused);
  const { feedback } = goal;
  const state = store.data("state");
  const drives = state?.mode === "follow" || state?.mode === "behaviour";
  const now = paused ? "Paused" : state?.mode === "stopped" ? "Stopped" : drives ? "Driving" : "Waiting";
  setText(card.querySelector("span"), `${now}: ${titleOf(goal)}`);
  const left = state?.plan?.goal_id === goal.id ? state.plan.distance_left : feedback?.distance_left;
  const time = state?.plan?.goal_id === goal.id ? state.plan.time_left : feedback?.time_left;
  setText(card.querySelector("h3 small"), Number.isFinite(left) ? `${left.toFixed(1)} m${drives && Number.isFinite(time) ? `, ${duration(time)}` : ""}` : "");
  const replans = feedback?.replans ? ` · replans: ${feedback.replans}` : "";
  const recoveries = feedback?.recoveries ? ` · recoveries: ${feedback.recoveries}` : "";
  const waits = feedback?.blockage ? " · path blocked, waiting" : "";
  setText(card.querySelector("p"), `${feedback?.step ?? ""}${replans}${recoveries}${waits}` || "starting");
  const bar = card.querySelector("progress");
  if (Number.isFinite(left)) {
    card.most = Math.max(card.most, left);
    bar.value = card.most > 0 ? 1 - left / card.most : 0;
  }
  const pause = card.querySelector(".pause");
  setText(pause, paused ? "Resume" : "Pause");
  pause.onclick = () => attempt(paused ? "Not resumed" : "Not paused", () => (paused ? resumeGoal : pauseGoal)(store.watched, goal.id));
}

/** Tells of goals that have ended since. */
function tellEnds() {
  for (const goal of store.goals.values()) {
    const key = `${store.watched} ${goal.id}`;
    if (!Number.isFinite(goal.ended)) open.add(key);
    else if (open.delete(key) && ENDS[goal.state]) {
      const [end, kind] = ENDS[goal.state];
      toast([`Goal ${end}`, titleOf(goal), goal.reason].filter(Boolean).join(": "), kind);
    }
  }
}

export function drawGoals() {
  tellEnds();
  const running = store.runningGoal();
  drawActive(running);
  const rest = [...store.goals.values()].filter((goal) => goal !== running);
  const waiting = queue();
  const ended = rest.filter((goal) => goal.state !== "Accepted").sort((a, b) => (b.ended ?? 0) - (a.ended ?? 0));
  const shown = [...waiting, ...ended].slice(0, SHOWN);
  const sign = JSON.stringify([store.watched, shown.map((goal) => [goal.id, goal.state, goal.reason, goal.queue]), Boolean(running)]);
  if (sign === drawn) return;
  drawn = sign;
  const empty = running ? [] : [el("li", { class: "empty" }, "No goals yet. Click on the map to send one; drag to set its heading.")];
  refill($("goal-list"), shown.length ? shown.map((goal, place) => row(goal, place, waiting.length)) : empty);
}

let listed = null;

function fillPlaces() {
  const names = Object.keys(store.places);
  const sign = JSON.stringify(names);
  if (sign === listed) return;
  listed = sign;
  const chosen = $("place").value;
  $("place").replaceChildren(...names.sort(byName).map((name) => el("option", { value: name }, name)));
  $("place").disabled = $("go-place").disabled = names.length === 0;
  if (!names.length) $("place").append(el("option", {}, "no places on this map"));
  else if (names.includes(chosen)) $("place").value = chosen;
}

/** After a list of goals that did not come, at first and at most, ms. */
const AGAIN = [3000, 60000];
let wait = AGAIN[0];

/** Goals that ended before this gateway started are asked for once. */
async function fetchGoals() {
  const robot = store.watched;
  if (!robot) return;
  const reply = await listGoals(robot).catch(() => null);
  if (robot !== store.watched) return;
  clearTimeout(again);
  if (!reply) {
    again = setTimeout(fetchGoals, wait);
    wait = Math.min(2 * wait, AGAIN[1]);
    return;
  }
  wait = AGAIN[0];
  for (const goal of reply.goals) if (!store.goals.has(goal.id)) store.goals.set(goal.id, goal);
  drawGoals();
}

export function startGoals() {
  const busy = () => (store.runningGoal() ? "queue" : "preempt");
  $("goal-form").onsubmit = (event) => {
    event.preventDefault();
    if ($("place").value) sendGoal({ place: $("place").value, on_busy: busy() });
  };
  // A form of its own: Enter in one of its fields must not send the robot to the place above.
  $("goal-numbers").onsubmit = (event) => {
    event.preventDefault();
    const [x, y, yaw] = ["goal-x", "goal-y", "goal-yaw"].map((id) => $(id).valueAsNumber);
    const goal = { x, y, on_busy: busy() };
    if (Number.isFinite(yaw)) goal.yaw = radians(yaw);
    sendGoal(goal);
  };
  fillPlaces();
  drawGoals();
  store.on("hello", fillPlaces);
  store.on("frame", fillPlaces);
  // The first frame of a robot's details begins the list anew.
  store.on("fresh", fetchGoals);
  store.on("frame", drawGoals);
}
