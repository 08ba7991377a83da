// Goals. Which run, wait, and have ended, and why?

import { cancelGoal, listGoals, pauseGoal, resumeGoal } from "./api.js";
import { $, degrees, duration, el, radians, setText, toast } from "./dom.js";
import { placeOf } from "./layers.js";
import { store } from "./store.js";
import { sendGoal } from "./tools.js";

const SHOWN = 30;
const SIGNS = {
  Accepted: ["…", "goal-text"], Succeeded: ["✓", "good-text"], Aborted: ["✗", "bad-text"], Canceled: ["–", "soft-text"], Rejected: ["✗", "bad-text"],
};
let drawn = "";

function titleOf(goal) {
  const { request } = goal;
  if (request.place) return request.place;
  if (Number.isFinite(request.x)) {
    const heading = Number.isFinite(request.yaw) ? `, ${degrees(request.yaw)}°` : "";
    return `${request.x.toFixed(2)}, ${request.y.toFixed(2)}${heading}`;
  }
  if (request.waypoints?.length) return `${request.waypoints.length} waypoints`;
  const tree = request.tree ?? "tree";
  return tree.length < 40 ? tree : "tree of the goal's own";
}

function seconds(from, to) {
  return (to - from) / 1e9;
}

async function act(call, what) {
  try {
    await call();
  } catch (error) {
    toast(`${what}: ${error.message}`, "bad");
  }
}

function outcomeOf(goal) {
  const took = goal.started && goal.ended ? `${duration(seconds(goal.started, goal.ended))}` : "";
  const plans = goal.feedback?.plans ? `${goal.feedback.plans} ${goal.feedback.plans === 1 ? "plan" : "plans"}` : "";
  return [goal.reason, goal.state === "Accepted" ? "waits" : took, plans].filter(Boolean).join(" · ");
}

function row(goal) {
  const [sign, kind] = SIGNS[goal.state] ?? ["", ""];
  const cancel = goal.state === "Accepted"
    ? el("button", { type: "button", "aria-label": `Cancel goal ${titleOf(goal)}`, onclick: () => act(() => cancelGoal(store.watched, goal.id), "Not cancelled") }, "Cancel")
    : null;
  return el("li", { title: goal.id },
    el("span", { class: kind, "aria-label": goal.state, role: "img" }, sign),
    el("span", {}, titleOf(goal), el("small", {}, outcomeOf(goal))), cancel);
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
        el("button", { type: "button", class: "pause" }), el("button", { type: "button", onclick: () => act(() => cancelGoal(store.watched, goal.id), "Not cancelled") }, "Cancel goal")));
    card.most = 0;
    box.replaceChildren(card);
  }
  const paused = goal.state === "Paused";
  card.classList.toggle("paused", paused);
  setText(card.querySelector("span"), `${paused ? "Paused" : "Driving"}: ${titleOf(goal)}`);
  const { feedback } = goal;
  const state = store.data("state");
  const left = state?.plan?.goal_id === goal.id ? state.plan.distance_left : feedback?.distance_left;
  const time = state?.plan?.goal_id === goal.id ? state.plan.time_left : feedback?.time_left;
  setText(card.querySelector("h3 small"), Number.isFinite(left) ? `${left.toFixed(1)} m${Number.isFinite(time) ? `, ${duration(time)}` : ""}` : "");
  const replans = feedback?.replans ? ` · replanned ${feedback.replans}×` : "";
  const recoveries = feedback?.recoveries ? ` · recovered ${feedback.recoveries}×` : "";
  const waits = feedback?.blockage ? " · waits for what bars the way" : "";
  setText(card.querySelector("p"), `${feedback?.step ?? ""}${replans}${recoveries}${waits}` || "starting");
  const bar = card.querySelector("progress");
  if (Number.isFinite(left)) {
    card.most = Math.max(card.most, left);
    bar.value = card.most > 0 ? 1 - left / card.most : 0;
  }
  const pause = card.querySelector(".pause");
  setText(pause, paused ? "Go on" : "Pause");
  pause.onclick = () => act(() => (paused ? resumeGoal : pauseGoal)(store.watched, goal.id), paused ? "Does not go on" : "Not paused");
}

export function drawGoals() {
  const running = store.runningGoal();
  drawActive(running);
  const rest = [...store.goals.values()].filter((goal) => goal !== running);
  const waiting = rest.filter((goal) => goal.state === "Accepted");
  waiting.sort((a, b) => (b.request.priority ?? 0) - (a.request.priority ?? 0) || a.accepted - b.accepted);
  const ended = rest.filter((goal) => goal.state !== "Accepted").sort((a, b) => (b.ended ?? 0) - (a.ended ?? 0));
  const shown = [...waiting, ...ended].slice(0, SHOWN);
  const sign = JSON.stringify([store.watched, shown.map((goal) => [goal.id, goal.state, goal.reason]), Boolean(running)]);
  if (sign === drawn) return;
  drawn = sign;
  const empty = running ? [] : [el("li", { class: "empty" }, "No goal yet. Click on the map; drag for the heading.")];
  $("goal-list").replaceChildren(...(shown.length ? shown.map(row) : empty));
}

let listed = null;

function fillPlaces() {
  const names = Object.keys(store.places);
  const sign = JSON.stringify(names);
  if (sign === listed) return;
  listed = sign;
  const chosen = $("place").value;
  $("place").replaceChildren(...names.map((name) => el("option", { value: name }, name)));
  $("place").disabled = $("go-place").disabled = names.length === 0;
  if (!names.length) $("place").append(el("option", {}, "the map names none"));
  else if (names.includes(chosen)) $("place").value = chosen;
}

/** Goals that ended before this gateway started are asked for once. */
async function fetchGoals() {
  const robot = store.watched;
  const reply = robot ? await listGoals(robot).catch(() => null) : null;
  if (!reply || robot !== store.watched) return;
  for (const goal of reply.goals) if (!store.goals.has(goal.id)) store.goals.set(goal.id, goal);
  drawGoals();
}

export function startGoals() {
  const busy = () => (store.runningGoal() ? "queue" : "preempt");
  $("goal-form").onsubmit = (event) => {
    event.preventDefault();
    if ($("place").value) sendGoal({ place: $("place").value, on_busy: busy() });
  };
  $("go-numbers").onclick = () => {
    const [x, y, yaw] = ["goal-x", "goal-y", "goal-yaw"].map((id) => $(id).valueAsNumber);
    if (!Number.isFinite(x) || !Number.isFinite(y)) {
      toast("A goal needs x and y in metres", "bad");
      return;
    }
    const goal = { x, y, on_busy: busy() };
    if (Number.isFinite(yaw)) goal.yaw = radians(yaw);
    sendGoal(goal);
  };
  store.on("hello", fillPlaces);
  store.on("frame", fillPlaces);
  store.on("watch", fetchGoals);
  store.on("frame", drawGoals);
}

export { placeOf };
