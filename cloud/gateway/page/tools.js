// Map tools. What does a press on the map mean? A goal to be confirmed, a distance, or a move of the map.

import { ApiError, freshId, submitGoal } from "./api.js";
import { $, degrees, setText, toast } from "./dom.js";
import { store } from "./store.js";

/** A drag shorter than this is a click, pixels. */
const CLICK = 14;

class Tools {
  constructor() {
    this.current = "goal";
    /** The goal that waits to be confirmed: `{ x, y, yaw }`, yaw null for any. */
    this.draft = null;
    this.measure = null;
    this.pressed = null;
    this.onchange = () => {};
  }

  choose(tool) {
    this.current = tool;
    for (const name of ["goal", "pan", "measure"]) $(`tool-${name}`).setAttribute("aria-pressed", String(name === tool));
    $("map").classList.toggle("pan", tool === "pan");
    if (tool !== "measure") this.measure = null;
    this.onchange();
  }

  down(at) {
    this.pressed = at;
    if (this.current === "goal") {
      this.draft = { x: at[0], y: at[1], yaw: null };
      $("draft").hidden = true;
    } else if (this.current === "measure") {
      this.measure = [at, at];
    }
  }

  move(at, scale) {
    if (!this.pressed) return;
    if (this.current === "goal" && this.draft) {
      const [dx, dy] = [at[0] - this.draft.x, at[1] - this.draft.y];
      this.draft.yaw = Math.hypot(dx, dy) * scale > CLICK ? Math.atan2(dy, dx) : null;
    } else if (this.current === "measure") {
      this.measure = [this.pressed, at];
    }
  }

  up() {
    if (!this.pressed) return;
    this.pressed = null;
    if (this.current === "goal" && this.draft) this.propose();
  }

  /** Drops what is being drawn: a second finger came. */
  abort() {
    this.pressed = null;
    this.drop();
  }

  /** Asks for the confirmation of a draft. */
  propose() {
    const { x, y, yaw } = this.draft;
    const heading = yaw === null ? "any heading" : `${degrees(yaw)}°`;
    setText($("draft-text"), `Goal ${x.toFixed(2)}, ${y.toFixed(2)} m, ${heading}`);
    $("draft-busy").parentElement.hidden = !store.runningGoal();
    $("draft").hidden = false;
    this.onchange();
  }

  drop() {
    this.draft = null;
    $("draft").hidden = true;
    this.onchange();
  }

  async confirm() {
    if (!this.draft) return;
    const { x, y, yaw } = this.draft;
    const goal = { x: round(x), y: round(y), on_busy: store.runningGoal() ? $("draft-busy").value : "queue" };
    if (yaw !== null) goal.yaw = round(yaw);
    const sent = this.draft;
    $("draft").hidden = true;
    if (!(await sendGoal(goal))) {
      // What was refused can be mended and sent again.
      if (this.draft === sent) this.propose();
      return;
    }
    if (this.draft === sent) this.drop();
  }
}

const round = (value) => Math.round(value * 1000) / 1000;

/** Submits a goal to the watched robot; `false` when it was refused. */
export async function sendGoal(goal) {
  if (!store.watched) return false;
  try {
    await submitGoal(store.watched, { id: freshId(), ...goal });
    toast("Goal accepted", "good");
    return true;
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    const near = error.body?.nearest_free;
    toast(`Goal refused: ${error.message}`, "bad");
    if (near && tools.draft) {
      tools.draft = { x: near.x, y: near.y, yaw: tools.draft.yaw };
      toast("The nearest free place is proposed instead");
    }
    return false;
  }
}

export const tools = new Tools();
