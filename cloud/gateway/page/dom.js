// Elements. How does the page make and change them? Text is always text: nothing from a robot is ever read as HTML.

export const $ = (id) => document.getElementById(id);

/** Makes an element: `el("li", { class: "warn", onclick }, "text", child)`. */
export function el(name, props = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (key === "class") node.className = value;
    else if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key in node && !key.startsWith("aria")) node[key] = value;
    else node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Sets a text only where it differs, so that a screen reader is not told twice. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** What is outside of an open dialog is behind it, and read to nobody. */
function bringForward(note) {
  const home = $("dialog").open ? $("dialog") : document.body;
  if (note.parentNode !== home) home.append(note);
}

/** Shows a note for a while. */
export function toast(text, kind = "") {
  bringForward($("toasts"));
  const node = el("div", { class: `toast ${kind}` }, text);
  const all = $("toasts");
  all.append(node);
  while (all.children.length > 4) all.firstChild.remove();
  setTimeout(() => node.remove(), kind === "bad" ? 9000 : 4500);
}

/** Says at once, to those who listen. */
export function alarm(text) {
  bringForward($("alarm"));
  setText($("alarm"), text);
}

/** Takes an alarm back, unless another one was raised since. */
export function calm(text) {
  if (text && $("alarm").textContent === text) alarm("");
}

/** Answers the question that is open with no. */
let refuse = () => {};

/** Asks before something is done; resolves to the text of the field, or `true`, or `null` for no, which another question says too. */
export function ask({ title, text, yes, field, wanted, value = "" }) {
  refuse();
  const dialog = $("dialog");
  setText($("dialog-title"), title);
  setText($("dialog-text"), text);
  setText($("dialog-yes"), yes);
  const input = $("dialog-input");
  $("dialog-field").hidden = !field;
  $("dialog-field").querySelector("span").textContent = field ?? "";
  input.value = value;
  const check = () => { $("dialog-yes").disabled = Boolean(wanted) && input.value.trim() !== wanted; };
  input.oninput = check;
  check();
  dialog.returnValue = "no";
  if (!dialog.open) dialog.showModal();
  (field ? input : dialog.querySelector("button[value=no]")).focus();
  return new Promise((resolve) => {
    refuse = () => resolve(null);
    dialog.onclose = () => {
      for (const note of ["toasts", "alarm"]) bringForward($(note));
      resolve(dialog.returnValue === "yes" ? (field ? input.value.trim() : true) : null);
    };
    input.onkeydown = (event) => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      if (!$("dialog-yes").disabled) dialog.close("yes");
    };
  });
}

/** Whether a key that was pressed belongs to a field. */
export function isTyping(event) {
  const at = event.target;
  if (at instanceof HTMLInputElement && at.type === "checkbox") return false;
  if (at instanceof HTMLInputElement && at.type === "range") return event.key.startsWith("Arrow");
  return at instanceof HTMLInputElement || at instanceof HTMLSelectElement || at instanceof HTMLTextAreaElement || at.closest?.("dialog");
}

/** A text with a capital first letter. */
export const capital = (text) => `${text[0].toUpperCase()}${text.slice(1)}`;

/** Order of names: `table_2` before `table_10`. */
export const byName = new Intl.Collator(undefined, { numeric: true }).compare;

export const degrees = (rad) => Math.round((rad * 180) / Math.PI);
export const radians = (deg) => (deg * Math.PI) / 180;

/** A duration in words: `4.8 s`, `2 min 05 s`. */
export function duration(secs) {
  if (!Number.isFinite(secs)) return "–";
  if (secs < 60) return `${secs.toFixed(secs < 10 ? 1 : 0)} s`;
  if (secs < 3600) return `${Math.floor(secs / 60)} min ${String(Math.floor(secs % 60)).padStart(2, "0")} s`;
  return `${Math.floor(secs / 3600)} h ${Math.floor((secs % 3600) / 60)} min`;
}

/** Nanoseconds of a robot's clock: time of day, here, and that day; or seconds since the start of a simulation. */
export function clockTime(stamp) {
  const secs = stamp / 1e9;
  if (secs < 1e8) return { time: `${secs.toFixed(1)} s`, day: "" };
  const date = new Date(secs * 1000);
  return { time: date.toLocaleTimeString([], { hourCycle: "h23" }), day: date.toLocaleString([], { dateStyle: "full", timeStyle: "long" }) };
}

/** Puts other rows into a list; what had the focus, by its name, keeps it: in the row of the same title, if it has one. */
export function refill(list, rows) {
  const at = document.activeElement;
  const name = list.contains(at) ? at.getAttribute("aria-label") : null;
  const row = name === null ? -1 : [...list.children].findIndex((child) => child.contains(at));
  const title = list.children[row]?.title;
  list.replaceChildren(...rows);
  if (name === null) return;
  // Names need not be unique in a list: two goals may have the same place.
  const within = title ? [...list.children].find((child) => child.title === title) : list;
  const same = [...within?.querySelectorAll("[aria-label]") ?? []].find((node) => node.getAttribute("aria-label") === name);
  // A control without a use at its new place, or one that is gone, leaves the focus beside it.
  const beside = (same?.closest("li") ?? list.children[Math.min(row, list.children.length - 1)])?.querySelector("button:not(:disabled)");
  (same && !same.disabled ? same : beside)?.focus({ preventScroll: true });
}

/** The number in a field: null if it is empty, NaN if it is none. */
export function numberIn(id) {
  const field = $(id);
  return field.value === "" && !field.validity.badInput ? null : field.valueAsNumber;
}
