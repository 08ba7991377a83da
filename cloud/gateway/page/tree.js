// Behaviour tree. What does the mission do now, and what failed last?

import { $, el, setText } from "./dom.js";
import { store } from "./store.js";

const SIGNS = { RUNNING: "▶", SUCCESS: "✓", FAILURE: "✗", SKIPPED: "↷", IDLE: "·" };
const CLASSES = { RUNNING: "running", SUCCESS: "success", FAILURE: "failure-now", SKIPPED: "skipped", IDLE: "" };
let shape = "";
/** Node to its last result, which an idle node keeps, dimmed. */
let last = new Map();
let failure = "";

function depths(nodes) {
  const depth = new Map();
  for (const node of nodes) depth.set(node.uid, node.parent === null || node.parent === undefined ? 0 : (depth.get(node.parent) ?? 0) + 1);
  return depth;
}

function build(nodes) {
  const depth = depths(nodes);
  $("tree").replaceChildren(...nodes.map((node) => {
    const name = node.name && node.name !== node.id ? `${node.name}` : node.id;
    const row = el("li", { title: node.id }, el("i", { "aria-hidden": "true" }), el("b", {}, name), el("small"));
    row.style.paddingLeft = `${depth.get(node.uid) * 14}px`;
    return row;
  }));
  last = new Map();
  failure = "";
}

export function drawTree() {
  const mission = store.data("mission");
  const nodes = mission?.nodes ?? [];
  if (mission) {
    const standby = mission.standbys?.length ? `, standby ${mission.standbys.join(", ")}` : "";
    const queued = mission.queued ? `, ${mission.queued} in the queue` : "";
    setText($("tree-head"), `${mission.tree ?? "no tree runs"} · mission ${mission.holder}${mission.leads ? "" : " (does not command)"}${queued}${standby}`);
  } else {
    setText($("tree-head"), "Nothing was heard of a mission.");
  }
  // The last tree stays until another one runs.
  if (!nodes.length) return;
  const now = JSON.stringify([store.watched, mission.goal_id, nodes.map((node) => [node.uid, node.parent, node.name])]);
  if (now !== shape) {
    shape = now;
    build(nodes);
  }
  const rows = $("tree").children;
  nodes.forEach((node, at) => {
    const row = rows[at];
    const kept = last.get(node.uid);
    if (node.status === "FAILURE" && kept !== "FAILURE" && node.feedback) failure = `${node.name || node.id}: ${node.feedback}`;
    if (node.status !== "IDLE" && node.status !== "RUNNING") last.set(node.uid, node.status);
    const was = node.status === "IDLE" && kept ? ` was-${kept.toLowerCase()}` : "";
    const style = `${CLASSES[node.status] ?? ""}${was}`;
    if (row.className !== style) row.className = style;
    setText(row.children[0], node.status === "IDLE" && kept ? SIGNS[kept] : SIGNS[node.status] ?? "?");
    setText(row.children[2], node.status === "IDLE" ? "" : node.feedback ?? "");
    const spoken = `${node.name || node.id}, ${node.status.toLowerCase()}`;
    if (row.getAttribute("aria-label") !== spoken) row.setAttribute("aria-label", spoken);
  });
  $("tree-failure").hidden = !failure;
  setText($("tree-failure"), failure ? `Last failure: ${failure}` : "");
}

export function startTree() {
  store.on("frame", () => {
    if (!$("panel-tree").hidden) drawTree();
  });
}
