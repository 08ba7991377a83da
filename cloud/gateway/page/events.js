// Events. What happened on the robot, in words?

import { $, clockTime, el, setText } from "./dom.js";
import { titleOf } from "./goals.js";
import { store } from "./store.js";

const SHOWN = 150;
/** Of each robot, the events that were on the screen: a page that reconnects hears them again. */
const seen = new Map();
const keyOf = (event) => `${event.boot_id} ${event.sequence}`;

/** How well the robot is localised, in words and as a kind of event. */
function localised(health) {
  const trusted = !["searching", "lost", "ambiguous"].includes(health.state);
  const places = health.hypotheses ? `, ${health.hypotheses.length} places` : "";
  return [`: ${health.state}${places}`, trusted ? "" : health.state === "searching" ? "warn" : "bad"];
}

/** The goal of an event, as it is listed. */
function goalOf({ goal_id: id }) {
  const goal = store.goals.get(id);
  return ` for ${goal ? titleOf(goal) : id}`;
}

/** Name, words and kind of an event. */
function told(event) {
  const reason = event.reason ? `: ${event.reason}` : "";
  switch (event.event) {
    case "started": return ["edge started", "", ""];
    case "plan_accepted": return ["plan accepted", goalOf(event), ""];
    case "plan_rejected": return ["plan refused", reason, "bad"];
    case "plan_finished": return ["plan finished", goalOf(event), ""];
    case "plan_expired": return ["plan expired", "; the robot is at rest", "warn"];
    case "plan_discarded": return ["plan discarded", reason, "warn"];
    case "bumped": return ["bumped", "; the contact sensor was pressed", "bad"];
    case "battery_low": return ["battery low", `: ${Math.round(event.charge * 100)} %`, "warn"];
    case "inputs_dropped": return ["inputs dropped", `: ${event.too_late} too late, ${event.broken} broken`, "warn"];
    case "teleop_dropped": return ["teleop dropped", reason, "warn"];
    case "guard": return [`collision monitor ${event.zone}`, reason, event.zone === "clear" ? "" : event.zone === "stop" ? "bad" : "warn"];
    case "lease": return ["lease", ` ${event.holder ?? "nobody"}, epoch ${event.epoch}${reason}`, ""];
    case "link_changed": return [`link ${event.link.toLowerCase()}`, "", event.link === "Connected" ? "" : event.link === "Lost" ? "bad" : "warn"];
    case "stopped": return ["stopped", ` by ${event.by}`, "bad"];
    case "localisation": return ["localisation", ...localised(event.health)];
    case "resumed": return ["resumed", ` by ${event.by}`, ""];
    case "behaviour_done": return [`maneuver ${event.report?.state ?? "done"}`, event.report?.reason ? `: ${event.report.reason}` : "", event.report?.state === "failed" ? "warn" : ""];
    case "transition": return [event.behaviour, ` ${event.from} → ${event.to}${reason}`, ""];
    default: return [event.event, ` ${JSON.stringify(event)}`, ""];
  }
}

export function drawEvents() {
  const shows = !$("panel-events").hidden;
  if (shows) seen.set(store.watched, new Set(store.events.map(keyOf)));
  const known = seen.get(store.watched);
  const count = $("tab-events").querySelector(".count");
  const unseen = store.events.filter((event) => !known?.has(keyOf(event)) && told(event)[2] === "bad").length;
  count.hidden = unseen === 0;
  setText(count.firstChild, String(unseen));
  if (!shows) return;
  const filter = $("event-filter").value.trim().toLowerCase();
  const words = filter ? filter.split(/\s+/) : [];
  const rows = [];
  for (let at = store.events.length - 1; at >= 0 && rows.length < SHOWN; at -= 1) {
    const event = store.events[at];
    const [name, text, kind] = told(event);
    const line = `${name} ${event.event} ${text}`.toLowerCase();
    if ($("event-warn").checked && !kind) continue;
    if (!words.every((word) => line.includes(word))) continue;
    const { time, day } = clockTime(event.stamp);
    rows.push(el("li", { class: kind }, el("time", { title: day }, time), el("span", {}, el("b", {}, name), text)));
  }
  $("events").replaceChildren(...(rows.length ? rows : [el("li", { class: "empty" }, store.events.length ? "No event matches." : "No event yet.")]));
}

export function startEvents() {
  $("event-filter").oninput = drawEvents;
  $("event-warn").onchange = drawEvents;
  store.on("events", drawEvents);
  store.on("watch", drawEvents);
}
