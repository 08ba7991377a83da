// Panel of the map. Which places and zones does it have, and how are they added, changed and removed? By a click, or by numbers.

import { deletePlace, deleteZone } from "./api.js";
import { $, ask, byName, capital, degrees, el, numberIn, radians, refill, toast } from "./dom.js";
import { cornersOf } from "./polygon.js";
import { attempt, savePlace, saveZone, sendPose } from "./send.js";
import { store } from "./store.js";
import { tools } from "./tools.js";

const limitOf = (zone) => zone.rule?.speed_limit?.max_speed ?? null;
let drawn = "";

async function remove(kind, name, call) {
  const robot = store.watched;
  const yes = await ask({ title: `Remove ${kind} “${name}”?`, text: `It is removed for all users, and for the missions of ${robot}.`, yes: "Remove" });
  if (yes && await attempt(`${capital(kind)} not removed`, () => call(robot, name))) toast(`${capital(kind)} “${name}” removed`, "good");
}

/** Asks for another name; the thing itself stays. */
async function rename(kind, name, save) {
  const robot = store.watched;
  const given = await ask({ title: `Rename ${kind}`, text: `New name of “${name}”.`, yes: "Rename", field: "Name", value: name });
  if (given && given !== name && robot === store.watched) save(given);
}

function row(kind, name, words, { edit, save, call }) {
  const button = (text, onclick) => el("button", { type: "button", "aria-label": `${text} ${kind} ${name}`, onclick }, text);
  return el("li", {}, el("span", {}, name, el("small", {}, words)), el("span", { class: "controls" },
    button("Edit", edit), button("Rename", () => rename(kind, name, save)), button("Remove", () => remove(kind, name, call))));
}

function placeRow([name, place]) {
  const heading = Number.isFinite(place.yaw) ? `, ${degrees(place.yaw)}°` : "";
  return row("place", name, `${place.x.toFixed(2)}, ${place.y.toFixed(2)} m${heading}`, {
    edit: () => tools.edit({ kind: "place", original: name, name, x: place.x, y: place.y, yaw: place.yaw ?? null }),
    save: (given) => savePlace(name, given, place),
    call: deletePlace,
  });
}

function zoneRow(zone) {
  const limit = limitOf(zone);
  return row("zone", zone.name, `${limit === null ? "keep-out" : `at most ${limit} m/s`}, ${zone.points.length} corners`, {
    edit: () => tools.edit({ kind: "zone", original: zone.name, name: zone.name, limit, closed: true, points: zone.points.map((point) => [...point]) }),
    save: (given) => saveZone(zone.name, given, { rule: zone.rule, points: zone.points }),
    call: deleteZone,
  });
}

function draw() {
  const sign = JSON.stringify([store.watched, store.places, store.zones]);
  if (sign === drawn) return;
  drawn = sign;
  const none = (text) => [el("li", { class: "empty" }, text)];
  const places = Object.entries(store.places).sort(([a], [b]) => byName(a, b));
  const zones = [...store.zones].sort((a, b) => byName(a.name, b.name));
  refill($("places"), places.length ? places.map(placeRow) : none("No places yet. Add one with the diamond tool (N)."));
  refill($("zones"), zones.length ? zones.map(zoneRow) : none("No zones yet. Draw one with the polygon tool (Z)."));
}

/** What stands in the fields for a place: null where a number is missing. */
function numbers() {
  const [x, y, heading] = ["at-x", "at-y", "at-yaw"].map(numberIn);
  if (!Number.isFinite(x) || !Number.isFinite(y) || Number.isNaN(heading)) {
    toast("Expected x and y in metres, and a heading in degrees or none", "bad");
    return null;
  }
  return { x, y, ...(heading === null ? {} : { yaw: radians(heading) }) };
}

export function startAnnotations() {
  $("add-place").onclick = () => {
    const at = numbers();
    if (at) savePlace(null, $("at-name").value.trim(), at);
  };
  $("set-pose").onclick = async () => {
    const at = numbers();
    if (!at) return;
    const pose = { ...at, yaw: at.yaw ?? store.data("pose")?.yaw ?? 0 };
    const robot = store.watched;
    const yes = await ask({ title: `Set the pose of ${robot}?`, text: "It stops and drops its plan.", yes: "Set pose" });
    if (yes && robot === store.watched) sendPose(pose);
  };
  $("add-zone").onclick = () => {
    const points = cornersOf($("zone-corners").value);
    if (!points) {
      toast("Expected x and y of three corners or more, in metres, with decimal points and spaces: 0.2 -1  0.8 -1  0.8 -0.4", "bad");
      return;
    }
    const limit = numberIn("zone-limit");
    if (Number.isNaN(limit)) {
      toast("Expected a speed limit in m/s, or none for keep-out", "bad");
      return;
    }
    saveZone(null, $("zone-name").value.trim(), { rule: limit === null ? "keep_out" : { speed_limit: { max_speed: limit } }, points });
  };
  store.on("frame", draw);
  store.on("watch", draw);
}
