// Behaviour tree. What does the mission do now, and what failed last?

import { $, el, setText } from "./dom.js";
import { titleOf } from "./goals.js";
import { store } from "./store.js";

const SIGNS = { RUNNING: "▶", SUCCESS: "✓", FAILURE: "✗", SKIPPED: "↷", IDLE: "·" };
const CLASSES = { RUNNING: "running", SUCCESS: "success", FAILURE: "failure-now", SKIPPED: "skipped", IDLE: "" };
let shape = "";
let failure = "";
/** The robot whose tree shows. */
let owner = null;
/** Nodes whose ports show. */
const open = new Set();

function depths(nodes) {
  const depth = new Map();
  for (const node of nodes) depth.set(node.uid, node.parent === null || node.parent === undefined ? 0 : (depth.get(node.parent) ?? 0) + 1);
  return depth;
}

function build(nodes) {
  const depth = depths(nodes);
  $("tree").replaceChildren(...nodes.map((node) => {
    const name = node.name && node.name !== node.id ? `${node.name}` : node.id;
    const toggle = el("button", { type: "button", class: "node", title: node.id, "aria-expanded": "false", onclick: () => {
      if (!open.delete(node.uid)) open.add(node.uid);
      drawTree();
    } }, el("i", { "aria-hidden": "true" }), el("b", {}, name), el("small"), el("span", { class: "hidden" }));
    const row = el("li", {}, toggle, el("dl", { hidden: true }));
    row.style.paddingLeft = `${depth.get(node.uid) * 14}px`;
    return row;
  }));
  open.clear();
  failure = "";
}

/** Ports of a node and what is on them. */
function drawPorts(row, node) {
  const ports = Object.entries(node.ports ?? {});
  const shows = ports.length > 0 && ($("tree-ports").checked || open.has(node.uid));
  const list = row.lastElementChild;
  list.hidden = !shows;
  row.firstElementChild.setAttribute("aria-expanded", String(shows));
  row.firstElementChild.disabled = ports.length === 0;
  const sign = shows ? JSON.stringify(ports) : "";
  if (list.dataset.sign === sign) return;
  list.dataset.sign = sign;
  list.replaceChildren(...(shows ? ports.flatMap(([port, words]) => [el("dt", {}, port), el("dd", {}, words)]) : []));
}

function drawFailure() {
  $("tree-failure").hidden = !failure;
  setText($("tree-failure"), failure ? `Last failure: ${failure}` : "");
}

/** Why the goal that ended last failed; empty if it did not. The failure that ends a tree is told with its goal, not with its nodes. */
function endOfTree() {
  const ended = [...store.goals.values()].filter((goal) => Number.isFinite(goal.ended));
  const last = ended.sort((a, b) => b.ended - a.ended)[0];
  return last?.state === "Aborted" && last.reason ? `goal ${titleOf(last)}: ${last.reason}` : "";
}

export function drawTree() {
  const mission = store.data("mission");
  const nodes = mission?.nodes ?? [];
  if (mission) {
    const standby = mission.standbys?.length ? ` · standby ${mission.standbys.join(", ")}` : "";
    const queued = mission.queued ? ` · ${mission.queued} queued` : "";
    const tree = mission.tree ? `Tree: ${mission.tree}` : shape ? "No tree is running; this is the last one" : "No tree is running";
    const standsBy = mission.leads ? "" : ` · ${mission.holder} is not in command`;
    setText($("tree-head"), `${tree}${standsBy}${queued}${standby}`);
  } else {
    setText($("tree-head"), "No message from a mission yet.");
  }
  // The last tree stays until another one runs, but nothing of it runs any more.
  if (!nodes.length) {
    for (const row of $("tree").querySelectorAll(".running")) {
      const [sign, , feedback, spoken] = row.firstElementChild.children;
      row.className = "";
      setText(sign, SIGNS.IDLE);
      setText(feedback, "");
      setText(spoken, ", ended");
    }
    failure = endOfTree() || failure;
    drawFailure();
    return;
  }
  const now = JSON.stringify([store.watched, mission.goal_id, nodes.map((node) => [node.uid, node.parent, node.name])]);
  if (now !== shape) {
    shape = now;
    build(nodes);
  }
  const rows = $("tree").children;
  nodes.forEach((node, at) => {
    const row = rows[at];
    const [sign, , feedback, spoken] = row.firstElementChild.children;
    const name = node.name || node.id;
    // An idle node keeps its last result, dimmed.
    const kept = node.status === "IDLE" ? node.last : "";
    if (node.last === "FAILURE" && node.feedback && node.status !== "RUNNING") failure = `${name}: ${node.feedback}`;
    const style = `${CLASSES[node.status] ?? ""}${kept ? ` was-${kept.toLowerCase()}` : ""}`;
    if (row.className !== style) row.className = style;
    setText(sign, SIGNS[kept || node.status] ?? "?");
    setText(feedback, node.status === "IDLE" ? "" : node.feedback ?? "");
    setText(spoken, `, ${node.status.toLowerCase()}${kept ? `, last ${kept.toLowerCase()}` : ""}`);
    drawPorts(row, node);
  });
  drawFailure();
}

export function startTree() {
  $("tree-ports").onchange = drawTree;
  store.on("watch", () => {
    if (owner === store.watched) return;
    owner = store.watched;
    shape = failure = "";
    $("tree").replaceChildren();
    drawFailure();
    drawTree();
  });
  drawTree();
  store.on("frame", () => {
    if (!$("panel-tree").hidden) drawTree();
  });
}
