// Header. How is the robot, who commands it, and how is it stopped?

import { resumeRobot, stopAll, stopRobot } from "./api.js";
import { $, alarm, ask, calm, capital, degrees, el, setText, toast } from "./dom.js";
import { watch } from "./live.js";
import { STALE, store } from "./store.js";

const MODES = {
  idle: ["idle", "good"], follow: ["following a plan", "good"], teleop: ["driven by hand", "warn"], behaviour: ["maneuver", "good"],
  wall_follow: ["following walls", "warn"], return_home: ["returning home", "warn"], stopped: ["STOPPED", "bad"],
};
/** A stop that is not confirmed is asked for again after a pause, and for so long, ms: a link that is lost for a moment comes back. */
const STOP_FOR = 15000;
const STOP_PAUSE = 500;
/** Answers of a gateway that will not change its mind: it does not let this page in. */
const FINAL = [401, 403];
/** The robots whose stop is not confirmed yet. */
const stopping = new Set();
/** Whether a stop of all robots is not confirmed yet. */
let stoppingAll = false;
/** The alarm that the banner has raised last; empty while the link is not bad. */
let raised = "";
let fitted = "";

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
  if (store.socket !== "open" && store.locked) return ["gateway needs its token", "bad", "The gateway gives no data without its token."];
  if (store.socket !== "open" && store.refused) return ["gateway refuses this page", "bad", "The gateway answers, but gives no live data. The page tries again by itself."];
  if (store.socket !== "open") return ["gateway lost: reconnecting …", "bad", "No connection to the gateway. The page reconnects by itself."];
  if (!store.connected) return ["bus lost", "bad", "The gateway does not reach the router."];
  if (!state) return ["waiting for the robot", "warn", "No state has been received yet."];
  if (store.age("state") > STALE) return ["robot silent", "bad", "The robot publishes no state."];
  const operator = state.lease.role === "operator" && state.lease.live;
  const trip = store.data("round_trip");
  const ping = store.pings.length ? median(store.pings) : null;
  const lost = trip ? `${Math.round(trip.loss * 100)} % lost` : "";
  const detail = [
    trip?.p50_ms != null ? `Round trip to the robot in the last two minutes: median ${trip.p50_ms} ms, 95th percentile ${trip.p95_ms} ms, ${lost}` : null,
    ping !== null ? `page to gateway ${ping.toFixed(0)} ms` : null,
  ].filter(Boolean).join("; ");
  if (state.link === "Lost" && !operator) return ["cloud lost: the robot is on its own", "bad", detail];
  if (state.link === "Stale") return ["cloud is late", "warn", detail];
  const kind = trip?.loss > 0.05 ? "warn" : "good";
  if (trip?.p50_ms == null) return ["link good", kind, detail];
  return [`link ${trip.p50_ms.toFixed(0)} ms`, kind, detail, `p95 ${trip.p95_ms.toFixed(0)} ms${trip.loss > 0 ? `, ${lost}` : ""}`];
}

function unbadge(id) {
  $("badges").querySelector(`[data-id="${id}"]`)?.remove();
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

/** What is said of the robot's pose in its present boot; null if nothing is. */
function healthOf() {
  const said = store.data("localisation");
  const state = store.data("state");
  return said && state && said.boot_id === state.boot_id ? said.health : null;
}

/** What a robot that does not know its place in the map is said to be; null while its pose is trusted. */
function astray() {
  const health = healthOf();
  switch (health?.state) {
    case "ambiguous": return `in one of ${health.hypotheses.length} places`;
    case "searching": return "lost, searching the map";
    case "lost": return "lost";
    default: return null;
  }
}

/** Words and kind of the badge on the robot's pose. */
function localised() {
  const lost = astray();
  if (lost) return [lost, "bad"];
  switch (healthOf()?.state) {
    case "contradicted": return ["scans contradict the map", "bad"];
    case "tracking": case "degraded": return ["localised", "good"];
    // So it is said, or nothing is.
    default: return ["pose unchecked", ""];
  }
}

function drawBadges() {
  const state = store.data("state");
  const stale = store.isStale();
  const [link, kind, title, small] = linkOf(state);
  badge("link", link, kind, title, small);
  if (!state) {
    // What shows was said of another robot, or before the gateway was lost.
    for (const node of [...$("badges").children]) if (node.dataset.id !== "link") node.remove();
    return;
  }
  const old = stale ? " stale" : "";
  const [mode, modeKind] = MODES[state.mode] ?? [state.mode, ""];
  badge("mode", mode, modeKind + old, "What decides the robot's motion");
  const guard = { slow: ["slowed", "warn"], stop: ["held by an obstacle", "bad"] }[state.guard];
  const pose = store.data("pose");
  const speed = pose ? `${Math.abs(pose.v).toFixed(2)} m/s` : "–";
  badge("speed", guard ? `${speed}, ${guard[0]}` : speed, (guard ? guard[1] : "") + old, "Speed, and the collision monitor's verdict");
  const charge = Math.round(state.battery * 100);
  badge("battery", `${charge} %`, (charge < 15 ? "bad" : charge < 30 ? "warn" : "") + old, "Battery", "battery");
  const [words, poseKind] = localised();
  badge("localisation", words, poseKind + old, "Whether the robot's scans agree with the known map");
  const { lease } = state;
  const mine = store.teleop.state === "armed" && store.teleop.robot === store.watched;
  const holder = !lease.live ? "nobody" : lease.role !== "operator" ? lease.holder ?? "nobody" : mine ? "this page" : "operator";
  badge("lease", holder, (lease.live ? (lease.role === "operator" ? "warn" : "good") : "warn") + old,
    `Who may command the robot: ${lease.live ? `${lease.holder}, ${lease.role}, epoch ${lease.epoch}` : "nobody holds the lease"}`, "in command");
  if (store.isMapOld()) badge("map", `map from ${age(store.mapAge())}`, `warn${old}`, "The robot's mapping service is gone: the map is as it was then");
  else unbadge("map");
}

/** The robot's pose in figures, beside the pointer's position. */
function drawPose() {
  const pose = store.data("pose");
  setText($("pose"), pose ? `robot ${pose.x.toFixed(2)}, ${pose.y.toFixed(2)} m, ${degrees(pose.yaw)}°` : "");
  $("pose").className = store.isStale() ? "stale" : "";
}

/** Leaves out details while the badges have no room for them. */
function fitBadges() {
  const badges = $("badges");
  const now = `${badges.textContent} ${badges.clientWidth}`;
  if (now === fitted) return;
  fitted = now;
  for (const fit of ["", "tight", "tighter", "tightest"]) {
    badges.className = fit;
    if (badges.scrollWidth <= badges.clientWidth) return;
  }
}

/** What the robot reports about its body and its storage that does not work, in words; empty if both do. */
function damageOf(state) {
  const { body, storage } = state?.faults ?? {};
  return [
    body && `gets no readings from its body: ${body}`,
    storage && `cannot save its lease epoch or its stop: a restart forgets them (${storage})`,
  ].filter(Boolean).join("; it ");
}

function drawBanner() {
  const state = store.data("state");
  const banner = $("banner");
  const robot = store.watched ?? "the robot";
  // Part of every banner: a stop that a restart forgets does not last until somebody resumes the robot.
  const damage = store.socket === "open" ? damageOf(state) : "";
  const say = (text, bad, old = "") => {
    banner.hidden = false;
    banner.className = bad ? "bad" : "";
    setText(banner.firstElementChild, [text, damage && `${robot} ${damage}.`].filter(Boolean).join(" "));
    setText(banner.lastElementChild, old);
  };
  const last = Number.isFinite(store.age("state")) ? `Last state: ${age(store.age("state"))}.` : "";
  const [link, kind] = linkOf(state);
  if (store.socket === "closed" && store.locked) say("The gateway needs its token: without it this page has no data, and STOP does not reach the robot.", true, last);
  else if (store.socket === "closed" && store.refused) say("The gateway answers, but gives this page no live data: too many browsers, or an origin that it does not know. This is old data. Trying again …", true, last);
  else if (store.socket === "closed") say("Gateway lost: this is old data, and STOP does not reach the robot from this page. Reconnecting …", true, last);
  else if (state && kind === "bad" && link.startsWith("cloud lost")) say("Cloud lost: the robot is on its own. STOP still works.", true);
  else if (state && kind === "bad") say(`${capital(link)}.`, true, last);
  else if (state?.mode === "stopped") say(`${robot} is stopped until somebody resumes it.`, true);
  else if (astray()) say(`${robot} is ${astray()}. It follows no plan until it is localised: set its pose on the map (P).`, true);
  else if (damage) say("", true);
  else if (state?.faults?.lidar) say(`${robot} drives slowly: ${state.faults.lidar}`, false);
  else if (state?.guard === "stop" && state.mode !== "idle") say("The collision monitor holds the robot: an obstacle is too close.", false);
  else banner.hidden = true;
  const next = kind === "bad" ? link : "";
  if (next === raised) return;
  if (next) alarm(next);
  else calm(raised);
  raised = next;
}

function drawStop() {
  const state = store.data("state");
  // What is old says nothing about now: the button stays a stop.
  const stopped = state?.mode === "stopped" && !store.isStale();
  const asked = stopping.has(store.watched);
  // A stop that is still asked for, of this robot or of all, would follow a resume.
  $("resume").hidden = !stopped || asked || stoppingAll;
  $("stop-all").hidden = store.fleet.length < 2;
  $("stop").classList.toggle("done", stopped && !asked);
  const text = asked ? "STOPPING" : stopped ? "STOPPED" : "STOP";
  setText($("stop").lastChild, text);
  setText($("dialog-stop"), text);
}

/** Asks for a stop until it is confirmed, or for `STOP_FOR`: whether it was. */
async function insist(ask) {
  const end = performance.now() + STOP_FOR;
  let told = "";
  for (;;) {
    try {
      await ask();
      calm(told);
      return true;
    } catch (error) {
      const last = FINAL.includes(error.status) || performance.now() > end;
      const missing = (error.body?.robots ?? []).filter((row) => !row.stopped).map((row) => row.robot);
      const whom = missing.length ? ` by ${missing.join(", ")}` : "";
      const text = `STOP NOT CONFIRMED${whom}: ${error.message}${last ? "" : "; asking again …"}`;
      if (text !== told) {
        alarm(text);
        toast(text, "bad");
        told = text;
      }
      if (last) return false;
    }
    await new Promise((resolve) => { setTimeout(resolve, STOP_PAUSE); });
  }
}

export async function stop() {
  const robot = store.watched;
  if (!robot || stopping.has(robot)) return;
  stopping.add(robot);
  drawStop();
  const confirmed = await insist(async () => {
    const { stopped } = await stopRobot(robot);
    if (!stopped) throw new Error("the robot says that it is not stopped");
  });
  if (confirmed) toast(`${robot} is stopped`, "good");
  stopping.delete(robot);
  drawStop();
}

export async function resume() {
  const robot = store.watched;
  const yes = await ask({
    title: `Resume ${robot}?`, text: "Its mission may drive on at once. Look at the robot first.", yes: "Resume",
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
  $("stop-all").disabled = true;
  stoppingAll = true;
  drawStop();
  let count = 0;
  const confirmed = await insist(async () => {
    const { robots } = await stopAll();
    count = robots.length;
  });
  if (confirmed) toast(`${count} robots are stopped`, "good");
  $("stop-all").disabled = false;
  stoppingAll = false;
  drawStop();
}

function drawFleet() {
  const select = $("robot");
  // The one that is watched stays in the list, heard or not.
  const names = !store.watched || store.fleet.includes(store.watched) ? store.fleet : [...store.fleet, store.watched];
  if (select.options.length !== names.length || [...select.options].some((option, at) => option.value !== names[at])) {
    select.replaceChildren(...names.map((robot) => el("option", { value: robot }, robot)));
  }
  select.parentElement.hidden = names.length === 0;
  if (store.watched) select.value = store.watched;
  const panel = $("fleet");
  panel.hidden = store.fleet.length < 2;
  if (panel.hidden) return;
  const list = panel.querySelector("ul");
  const known = new Map([...list.children].map((row) => [row.dataset.robot, row]));
  const rows = store.fleet.map((robot) => {
    const row = known.get(robot) ?? el("li", { "data-robot": robot },
      el("button", { type: "button", title: robot, onclick: () => watch(robot) }, el("i"), el("span", {}, robot), el("small"), el("small")));
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
    setText(note, `Last message of the mission: ${age(store.age("mission"))}.`);
  }
}

/** Draws everything that ages. */
export function drawHeader() {
  drawAges();
  drawBadges();
  drawPose();
  drawBanner();
  drawStop();
  drawFleet();
  fitBadges();
}

export function startHeader() {
  $("stop").onclick = stop;
  $("dialog-stop").onclick = stop;
  $("resume").onclick = resume;
  $("stop-all").onclick = everybody;
  $("robot").onchange = (event) => {
    watch(event.target.value);
    // Keys are for the robot again, not for the list.
    $("map").focus({ preventScroll: true });
  };
}
