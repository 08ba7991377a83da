// Draft. What is asked before something that was drawn on the map is sent?

import { $, degrees, setText, toast } from "./dom.js";
import { saveZone, savePlace, sendGoal, sendPose } from "./send.js";
import { store } from "./store.js";

const round = (value) => Math.round(value * 1000) / 1000;
const rounded = ([x, y]) => [round(x), round(y)];
/** Label of the button that sends, and which fields belong to it. */
const KINDS = {
  goal: { send: "Send", fields: ["busy"] },
  pose: { send: "Set pose", fields: [] },
  place: { send: "Save", fields: ["name"] },
  zone: { send: "Save", fields: ["name", "rule"] },
};
/** The draft that the fields belong to: they are filled once, and then left to the person. */
let filled = null;

function words(draft) {
  const heading = draft.yaw === null ? "any heading" : `${degrees(draft.yaw ?? 0)}°`;
  const at = draft.kind === "zone" ? "" : `${draft.x.toFixed(2)}, ${draft.y.toFixed(2)} m, ${heading}`;
  switch (draft.kind) {
    case "goal": return `Goal ${at}`;
    case "pose": return `Pose of ${store.watched}: ${at}. It stops and drops its plan`;
    case "place": return `Place ${at}`;
    default: return draft.closed ? `Zone, ${draft.points.length} corners` : draft.points.length < 3
      ? "Zone: click its corners" : "Zone: click the first corner or press Enter to close it";
  }
}

function fill(draft) {
  const key = draft.original ?? draft.kind;
  if (filled === key) return;
  filled = key;
  $("draft-name").value = draft.name ?? "";
  $("draft-rule").value = draft.limit === null || draft.limit === undefined ? "keep_out" : "speed_limit";
  $("draft-limit").value = draft.limit ?? 0.2;
}

export function showDraft(draft) {
  const { send, fields } = KINDS[draft.kind];
  const open = draft.kind === "zone" && !draft.closed;
  fill(draft);
  setText($("draft-text"), words(draft));
  for (const field of ["busy", "name", "rule"]) $(`draft-${field}`).parentElement.hidden = open || !fields.includes(field);
  if (!store.isBusy()) $("draft-busy").parentElement.hidden = true;
  limitOf();
  setText($("draft-send").firstChild, open ? "Close " : `${send} `);
  $("draft-send").disabled = open && draft.points.length < 3;
  const first = $("draft").hidden || open !== ($("draft").dataset.open === "true");
  $("draft").hidden = false;
  $("draft").dataset.open = String(open);
  if (first && fields.includes("name") && !open && !draft.original) $("draft-name").focus();
}

export function hideDraft() {
  $("draft").hidden = true;
}

/** The limit that the fields say, null for keep-out; a field without meaning is not shown. */
function limitOf() {
  const limits = $("draft-rule").value === "speed_limit";
  $("draft-limit").parentElement.hidden = !limits || $("draft-rule").parentElement.hidden;
  return limits ? $("draft-limit").valueAsNumber : null;
}

/** A draft with what its fields say. */
export function readDraft(draft) {
  return { ...draft, name: $("draft-name").value.trim() };
}

/** Hides it and forgets what its fields say: the next draft is another one. */
export function dropDraft() {
  hideDraft();
  filled = null;
}

/** Sends a draft: whether it was taken, and where else a refused goal could be. */
export async function sendDraft(draft) {
  hideDraft();
  const { x, y, yaw, kind, original, points } = draft;
  const name = $("draft-name").value.trim();
  const at = { x: round(x ?? 0), y: round(y ?? 0), ...(yaw === null || yaw === undefined ? {} : { yaw: round(yaw) }) };
  let result;
  if (kind === "goal") {
    const { sent, near } = await sendGoal({ ...at, on_busy: store.isBusy() ? $("draft-busy").value : "queue" });
    if (near) toast("The nearest free position is proposed instead");
    result = { done: sent, near };
  } else if (kind === "pose") {
    result = { done: await sendPose(at) };
  } else if (kind === "place") {
    result = { done: await savePlace(original, name, at) };
  } else {
    const limit = limitOf();
    const rule = limit === null ? "keep_out" : { speed_limit: { max_speed: limit } };
    result = { done: await saveZone(original, name, { rule, points: points.map(rounded) }) };
  }
  return result;
}

export function startDraft(tools) {
  $("draft").onsubmit = (event) => {
    event.preventDefault();
    tools.confirm();
  };
  $("draft-cancel").onclick = () => tools.drop();
  const change = () => {
    const limit = limitOf();
    if (tools.draft?.kind === "zone") tools.draft.limit = Number.isFinite(limit) ? limit : null;
    tools.onchange();
  };
  $("draft-rule").onchange = change;
  $("draft-limit").oninput = change;
}
