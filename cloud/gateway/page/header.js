// Header. How is the robot, who commands it, and how is it stopped?

import { resumeRobot, stopAll, stopRobot } from "./api.js";
import { $, alarm, ask, el, setText, toast } from "./dom.js";
import { watch } from "./live.js";
import { STALE, store } from "./store.js";

const MODES = {
  idle: ["at rest", "good"], follow: ["follows a plan", "good"], teleop: ["driven by hand", "warn"], behaviour: ["maneuver", "good"],
  wall_follow: ["follows walls alone", "warn"], return_home: ["drives home alone", "warn"], stopped: ["STOPPED", "bad"],
};
/** The robots whose stop is not confirmed yet. */
const stopping = new Set();
let told = "";

function age(seconds) {
  if (!Number.isFinite(seconds)) return "never heard";
  return seconds < 60 ? `${seconds.toFixed(0)} s ago` : `${Math.floor(seconds / 60)} min ago`;
}

function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)];
}

/** The link, from the page to the robot's command: text, kind, what stands in the tooltip. */
export function linkOf(state) {
  if (store.socket !== "open") return ["gateway lost: connecting again …", "bad", "The page does not hear the gateway. It tries again by itself."];
  if (!store.connected) return ["bus lost", "bad", "The gateway does not reach the router."];
  const silent = store.age("state");
  if (!state) return ["waiting for the robot", "warn", "Nothing was heard of it yet."];
  if (silent > STALE) return [`robot silent, ${age(silent)}`, "bad", "The robot has published no state."];
  const operator = state.lease.role === "operator" && state.lease.live;
  const trip = store.data("round_trip");
  const ping = store.pings.length ? median(store.pings) : null;
  const lost = trip ? `${Math.round(trip.loss * 100)} % lost` : "";
  const detail = [
    trip?.p50_ms != null ? `Round trip to the robot in the last two minutes: median ${trip.p50_ms} ms, 95 of 100 within ${trip.p95_ms} ms, ${lost}` : null,
    ping !== null ? `page to gateway ${ping.toFixed(0)} ms` : null,
  ].filter(Boolean).join("; ");
  if (state.link === "Lost" && !operator) return ["cloud lost: the robot is on its own", "bad", detail];
  if (state.link === "Stale") return ["cloud is late", "warn", detail];
  const kind = trip?.loss > 0.05 ? "warn" : "good";
  return [trip?.p50_ms != null ? `link ${trip.p50_ms.toFixed(0)} ms` : "link good", kind, detail, trip?.p50_ms != null ? `p95 ${trip.p95_ms.toFixed(0)} ms, ${lost}` : ""];
}

function badge(id, text, kind, title, small) {
  const all = $("badges");
  let node = all.querySelector(`[data-id="${id}"]`);
  if (!node) {
    node = el("li", { "data-id": id }, el("span"), el("small"));
    all.append(node);
  }
  node.className = `badge ${kind}`;
  node.title = title ?? "";
  setText(node.firstElementChild, text);
  setText(node.lastElementChild, small ?? "");
  node.lastElementChild.hidden = !small;
}

/** What a robot that does not know its place in the map is said to be; null while its pose is trusted. */
function astray() {
  const said = store.data("localisation");
  const state = store.data("state");
  if (!said || !state || said.boot_id !== state.boot_id) return null;
  const { health } = said;
  switch (health.state) {
    case "ambiguous": return `in one of ${health.hypotheses.length} places`;
    case "searching": return "lost, looking for itself in the map";
    case "lost": return "lost";
    default: return null;
  }
}

function drawBadges() {
  const state = store.data("state");
  const stale = store.isStale();
  const [link, kind, title, small] = linkOf(state);
  badge("link", link, kind, title, small);
  if (!state) return;
  const old = stale ? " stale" : "";
  const [mode, modeKind] = MODES[state.mode] ?? [state.mode, ""];
  badge("mode", mode, modeKind + old, "What decides the robot's motion");
  const guard = { slow: ["slowed", "warn"], stop: ["held by an obstacle", "bad"] }[state.guard];
  const pose = store.data("pose");
  const speed = pose ? `${Math.abs(pose.v).toFixed(2)} m/s` : "–";
  badge("speed", guard ? `${speed}, ${guard[0]}` : speed, (guard ? guard[1] : "") + old, "Speed, and the collision monitor's verdict");
  const charge = Math.round(state.battery * 100);
  badge("battery", `${charge} %`, (charge < 15 ? "bad" : charge < 30 ? "warn" : "") + old, "Battery", "battery");
  const lost = astray();
  badge("localisation", lost ?? "on its map", (lost ? "bad" : "good") + old, "Whether the robot's scans agree with the map", "localised");
  const { lease } = state;
  const holder = lease.live ? lease.holder ?? "nobody" : "nobody";
  badge("lease", holder, (lease.live ? (lease.role === "operator" ? "warn" : "good") : "warn") + old,
    `Who may command the robot: ${lease.live ? `${lease.holder}, ${lease.role}, epoch ${lease.epoch}` : "nobody holds the lease"}`, "commands");
}

function drawBanner() {
  const state = store.data("state");
  const banner = $("banner");
  const robot = store.watched ?? "the robot";
  const say = (text, bad) => {
    banner.hidden = false;
    banner.className = bad ? "bad" : "";
    setText(banner, text);
  };
  const [link, kind] = linkOf(state);
  if (store.socket === "closed") say("Gateway lost: what shows is old, and STOP does not reach the robot from here. Connecting again …", true);
  else if (state && kind === "bad") say(`${link[0].toUpperCase()}${link.slice(1)}. What shows is ${age(store.age("state"))}.`, true);
  else if (state?.mode === "stopped") say(`${robot} is stopped, and stays so until it is resumed.`, true);
  else if (astray()) say(`${robot} is ${astray()}. It follows no plan until it knows its place: set its pose on the map.`, true);
  else if (state?.guard === "stop" && state.mode !== "idle") say("The collision monitor holds the robot: something is too close.", false);
  else banner.hidden = true;
  if (state && kind === "bad" && link.startsWith("cloud lost")) setText(banner, `Cloud lost: the robot is on its own. Stop works all the same.`);
  const now = `${link}, ${state?.mode ?? ""}`;
  if (now !== told && kind === "bad") alarm(link);
  told = now;
}

function drawStop() {
  const state = store.data("state");
  // What is old says nothing about now: the button stays a stop.
  const stopped = state?.mode === "stopped" && !store.isStale();
  $("resume").hidden = !stopped;
  $("stop-all").hidden = store.fleet.length < 2;
  const asked = stopping.has(store.watched);
  $("stop").classList.toggle("done", stopped && !asked);
  const text = asked ? "STOPPING" : stopped ? "STOPPED" : "STOP";
  setText($("stop").lastChild, text);
  setText($("dialog-stop"), text);
}

export async function stop() {
  const robot = store.watched;
  if (!robot || stopping.has(robot)) return;
  stopping.add(robot);
  drawStop();
  for (let attempt = 1; ; attempt += 1) {
    try {
      const { stopped } = await stopRobot(robot);
      if (stopped) {
        toast(`${robot} is stopped`, "good");
        break;
      }
      throw new Error("the robot says that it is not stopped");
    } catch (error) {
      alarm(`Stop not confirmed: ${error.message}`);
      toast(`STOP NOT CONFIRMED (try ${attempt}): ${error.message}`, "bad");
      if (attempt === 3) break;
    }
  }
  stopping.delete(robot);
  drawStop();
}

export async function resume() {
  const robot = store.watched;
  const yes = await ask({
    title: `Resume ${robot}?`, text: "Its mission may send it off at once, from where it stands. Look at the robot first.", yes: "Resume",
  });
  if (!yes) return;
  try {
    await resumeRobot(robot);
    toast(`${robot} may drive again`, "good");
  } catch (error) {
    toast(`Not resumed: ${error.message}`, "bad");
  }
}

async function everybody() {
  try {
    const { robots } = await stopAll();
    toast(`${robots.length} robots are stopped`, "good");
  } catch (error) {
    const missing = (error.body?.robots ?? []).filter((row) => !row.stopped).map((row) => row.robot);
    alarm("Stop not confirmed by every robot");
    toast(`STOP NOT CONFIRMED by ${missing.join(", ") || "the gateway"}: ${error.message}`, "bad");
  }
}

function drawFleet() {
  const select = $("robot");
  // The one that is watched stays in the list, heard or not.
  const names = !store.watched || store.fleet.includes(store.watched) ? store.fleet : [...store.fleet, store.watched];
  if (select.options.length !== names.length || [...select.options].some((option, at) => option.value !== names[at])) {
    select.replaceChildren(...names.map((robot) => el("option", { value: robot }, robot)));
  }
  if (store.watched) select.value = store.watched;
  const panel = $("fleet");
  panel.hidden = store.fleet.length < 2;
  if (panel.hidden) return;
  const list = panel.querySelector("ul");
  const known = new Map([...list.children].map((row) => [row.dataset.robot, row]));
  const rows = store.fleet.map((robot) => {
    const row = known.get(robot) ?? el("li", { "data-robot": robot },
      el("button", { type: "button", onclick: () => watch(robot) }, el("i"), el("span", {}, robot), el("small"), el("small")));
    const [sign, , mode, charge] = row.firstChild.children;
    const state = store.data("state", robot);
    const stale = store.isStale(robot);
    sign.className = stale ? "" : state.mode === "stopped" || state.guard === "stop" ? "bad" : state.link === "Lost" ? "warn" : "good";
    setText(mode, stale ? age(store.age("state", robot)) : MODES[state.mode]?.[0] ?? state.mode);
    setText(charge, state ? `${Math.round(state.battery * 100)} %` : "");
    row.firstChild.setAttribute("aria-current", String(robot === store.watched));
    row.classList.toggle("stale", stale);
    return row;
  });
  // A row that is taken out while it is pressed loses the click, and its focus.
  if (rows.length !== list.children.length || rows.some((row, at) => row !== list.children[at])) list.replaceChildren(...rows);
}

/** Goals and tree are the mission's word: without it they are as it was heard last. */
function drawAges() {
  const state = store.data("state");
  const old = store.isStale() || state?.link === "Lost" && !(state.lease.role === "operator" && state.lease.live);
  const known = Number.isFinite(store.age("mission"));
  for (const id of ["goals", "panel-tree"]) $(id).classList.toggle("old", old && known);
  for (const note of document.querySelectorAll(".old-note")) {
    note.hidden = !(old && known);
    setText(note, `The mission was heard last ${age(store.age("mission"))}.`);
  }
}

/** Draws everything that ages. */
export function drawHeader() {
  drawAges();
  drawBadges();
  drawBanner();
  drawStop();
  drawFleet();
}

export function startHeader() {
  $("stop").onclick = stop;
  $("dialog-stop").onclick = stop;
  $("resume").onclick = resume;
  $("stop-all").onclick = everybody;
  $("robot").onchange = (event) => {
    watch(event.target.value);
    // Keys are for the robot again, not for the list.
    event.target.blur();
  };
}
