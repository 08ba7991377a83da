// Mission control. Joins the parts of the page.

import { startAnnotations } from "./annotations.js";
import { $, el, isTyping, setText } from "./dom.js";
import { startDraft } from "./draft.js";
import { drives, startDrive } from "./drive.js";
import { drawEvents, startEvents } from "./events.js";
import { startGoals } from "./goals.js";
import { drawHeader, startHeader, stop } from "./header.js";
import { FAR, NEAR_TO_FAR } from "./grid.js";
import { RAMP, gradient, layers, shownPlan } from "./layers.js";
import { connect } from "./live.js";
import { recall, recallJson, remember } from "./memory.js";
import { startPlots } from "./plots.js";
import { store } from "./store.js";
import { TOOLS, tools } from "./tools.js";
import { drawTree, startTree } from "./tree.js";
import { fit, panKeys, readColours, redraw, setFollow, startView, view, zoom } from "./view.js";

const THEME = "zenav-theme";
const LAYERS = "zenav-layers";

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  readColours();
}

function startTheme() {
  const wished = window.matchMedia("(prefers-color-scheme: light)");
  let chosen = recall(THEME);
  const now = () => chosen ?? (wished.matches ? "light" : "dark");
  wished.addEventListener("change", () => setTheme(now()));
  $("theme").onclick = () => {
    chosen = now() === "light" ? "dark" : "light";
    remember(THEME, chosen);
    setTheme(chosen);
  };
  document.documentElement.dataset.theme = now();
}

function startLayers() {
  const kept = recallJson(LAYERS, {});
  for (const [name, layer] of Object.entries(layers)) {
    layer.on = kept[name] ?? layer.on;
    const box = el("input", { type: "checkbox", id: `layer-${name}`, checked: layer.on });
    box.onchange = () => {
      layer.on = box.checked;
      remember(LAYERS, JSON.stringify(Object.fromEntries(Object.entries(layers).map(([key, value]) => [key, value.on]))));
      drawLegend();
      redraw();
    };
    const sign = el("i");
    sign.style.background = layer.sign;
    $("layers").append(el("label", {}, box, sign, layer.title));
  }
}

/** Panels over the map, of which one at most is open. */
const FLYOUTS = ["layers", "help"];

function openFlyout(name) {
  for (const each of FLYOUTS) {
    $(each).hidden = each !== name;
    $(`${each}-button`).setAttribute("aria-expanded", String(each === name));
  }
}

function startFlyouts() {
  for (const name of FLYOUTS) $(`${name}-button`).onclick = () => openFlyout($(name).hidden ? name : null);
}

function startTabs() {
  const tabs = ["tree", "events", "map", "drive", "plots"];
  const choose = (name, focus) => {
    for (const tab of tabs) {
      const chosen = tab === name;
      $(`tab-${tab}`).setAttribute("aria-selected", String(chosen));
      $(`tab-${tab}`).tabIndex = chosen ? 0 : -1;
      $(`panel-${tab}`).hidden = !chosen;
    }
    if (focus) $(`tab-${name}`).focus();
    drawTree();
    drawEvents();
  };
  for (const [at, tab] of tabs.entries()) {
    $(`tab-${tab}`).onclick = () => choose(tab);
    $(`tab-${tab}`).onkeydown = (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step) choose(tabs[(at + step + tabs.length) % tabs.length], true);
    };
  }
}

function startToolbar() {
  for (const tool of TOOLS) $(`tool-${tool}`).onclick = () => tools.choose(tool);
  $("zoom-in").onclick = () => zoom(1.4);
  $("zoom-out").onclick = () => zoom(1 / 1.4);
  $("fit").onclick = () => {
    setFollow(false);
    fit();
  };
  $("follow").onclick = () => setFollow($("follow").getAttribute("aria-pressed") !== "true");
}

function startLegend() {
  $("legend-plan").querySelector("b").style.backgroundImage = gradient(RAMP);
  $("legend-clearance").querySelector("b").style.backgroundImage = gradient(NEAR_TO_FAR);
  setText($("legend-clearance").querySelector("i:last-child"), `${FAR} m or more`);
}

function drawLegend() {
  const plan = shownPlan();
  $("legend-plan").hidden = !plan;
  $("legend-clearance").hidden = !layers.clearance.on;
  $("legend").hidden = !plan && !layers.clearance.on;
  if (!plan) return;
  const [title, , scale, room] = $("legend-plan").children;
  const note = plan.expired ? ", plan expired" : store.isStale() ? ", as last heard" : "";
  setText(title, `Planned speed${note}`);
  setText(scale.lastChild, `${plan.top.toFixed(2)} m/s`);
  const clearance = plan.min_clearance === null ? "" : `clearance ${plan.min_clearance.toFixed(2)} m`;
  const corridor = plan.corridor_width === null ? "" : `corridor ${plan.corridor_width.toFixed(2)} m`;
  setText(room, [clearance, corridor].filter(Boolean).join(", "));
}

function startKeys() {
  const press = (id) => $(id).click();
  const keys = {
    g: () => tools.choose("goal"), h: () => tools.choose("pan"), m: () => tools.choose("measure"), p: () => tools.choose("pose"), n: () => tools.choose("place"),
    z: () => tools.choose("zone"), delete: () => tools.removeCorner(), backspace: () => tools.removeCorner(), f: () => press("follow"),
    l: () => press("layers-button"), "?": () => press("help-button"),
    0: () => press("fit"), "+": () => zoom(1.4), "=": () => zoom(1.4), "-": () => zoom(1 / 1.4), s: () => { if (!drives()) stop(); }, x: stop,
  };
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("dialog").open) return;
    if (event.key === "Escape") {
      tools.drop();
      tools.measure = null;
      openFlyout(null);
      redraw();
      return;
    }
    if (isTyping(event)) return;
    if (event.key === "Enter" && tools.draft && !$("draft").hidden && !(event.target instanceof HTMLButtonElement)) {
      event.preventDefault();
      tools.confirm();
      return;
    }
    if (event.target === $("map") && !drives() && panKeys(event)) {
      event.preventDefault();
      return;
    }
    const act = keys[event.key.toLowerCase()];
    if (act && !(drives() && "wasdqe".includes(event.key.toLowerCase()))) act();
  });
}

startTheme();
startLegend();
startLayers();
startFlyouts();
startTabs();
startToolbar();
startKeys();
startHeader();
startGoals();
startDraft(tools);
startAnnotations();
startTree();
startEvents();
startDrive();
startPlots();
startView();
connect();
// Ages grow also when nothing comes.
setInterval(() => {
  drawHeader();
  drawLegend();
  redraw();
}, 250);
store.on("frame", drawHeader);
store.on("socket", drawHeader);
// For tests, and for those who look closely.
window.zenav = { store, view, tools };
