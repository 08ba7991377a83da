// Map tools. What does a press on the map mean? A goal, a pose or a place to be confirmed, a corner of a zone, a distance, or a move of the map.

import { $, setText } from "./dom.js";
import { dropDraft, hideDraft, readDraft, sendDraft, showDraft } from "./draft.js";
import { cornerNear, sideNear } from "./polygon.js";
import { store } from "./store.js";

/** A drag shorter than this is a click, pixels. */
const CLICK = 14;
/** A press takes hold of a corner or a side within this distance, pixels. */
const GRIP = 12;
/** What to do with each tool; nothing for the one of the first moment. */
const HINTS = {
  goal: "", pan: "Drag to pan", measure: "Drag to measure", pose: "Click where the robot is; drag to set its heading",
  place: "Click to add a place; drag to set its heading", zone: "Click the corners of the zone",
};
export const TOOLS = Object.keys(HINTS);

class Tools {
  constructor() {
    this.current = "goal";
    /**
     * What waits to be confirmed. `kind` is `goal`, `pose` or `place`, with `x`, `y` and `yaw` (null for any); or `zone`, with `points`,
     * whether they are `closed`, and its `limit` (null for keep-out). `original` is the name of a place or zone that is edited, `robot` whose
     * map it was drawn on.
     */
    this.draft = null;
    this.measure = null;
    this.pressed = null;
    /** What was there before the press, for one that is taken back. */
    this.before = null;
    /** The corner that is held, or was held last. */
    this.corner = -1;
    this.onchange = () => {};
  }

  /** The heading that a drag sets now, rad; null without a drag. */
  get heading() {
    return this.pressed ? this.draft?.yaw ?? null : null;
  }

  choose(tool) {
    if (this.draft && this.draft.kind !== tool && tool !== "pan") this.drop();
    this.current = tool;
    for (const name of TOOLS) $(`tool-${name}`).setAttribute("aria-pressed", String(name === tool));
    $("map").classList.toggle("pan", tool === "pan");
    setText($("hint"), HINTS[tool]);
    if (tool !== "measure") this.measure = null;
    this.onchange();
  }

  /** Begins with something that is there: a place or a zone to be edited. */
  edit(draft) {
    this.choose(draft.kind);
    // On a narrow screen the panels lie below the map.
    scrollTo(0, 0);
    dropDraft();
    this.draft = { ...draft, robot: store.watched };
    this.corner = -1;
    this.propose();
  }

  down(at, scale) {
    this.pressed = at;
    const { draft } = this;
    this.before = draft && { draft, points: draft.points?.slice(), closed: draft.closed };
    if (this.current === "zone") this.hold(at, GRIP / scale);
    else if (this.current === "measure") this.measure = [at, at];
    else if (this.current !== "pan") {
      const named = this.draft?.kind === this.current ? readDraft(this.draft) : {};
      this.draft = { ...named, robot: store.watched, kind: this.current, x: at[0], y: at[1], yaw: null };
      hideDraft();
    }
  }

  /** Takes hold of a corner of the zone that is drawn, of a new one on a side of it, or adds one at its end. */
  hold(at, reach) {
    this.draft ??= { robot: store.watched, kind: "zone", points: [], closed: false, limit: null };
    const { points, closed } = this.draft;
    this.corner = cornerNear(points, at, reach);
    if (!closed && this.corner === 0 && points.length > 2) {
      this.draft.closed = true;
      this.corner = -1;
    } else if (!closed && this.corner < 0) {
      points.push(at);
      this.corner = points.length - 1;
    } else if (closed && this.corner < 0) {
      const side = sideNear(points, at, reach);
      if (side < 0) return;
      points.splice(side + 1, 0, at);
      this.corner = side + 1;
    }
  }

  move(at, scale) {
    if (!this.pressed) return;
    if (this.current === "zone") {
      if (this.corner >= 0) this.draft.points[this.corner] = at;
    } else if (this.current === "measure") {
      this.measure = [this.pressed, at];
    } else if (this.draft) {
      const [dx, dy] = [at[0] - this.draft.x, at[1] - this.draft.y];
      this.draft.yaw = Math.hypot(dx, dy) * scale > CLICK ? Math.atan2(dy, dx) : null;
    }
  }

  /** Ends a press; with `asks` even a goal is confirmed first. */
  up(asks) {
    if (!this.pressed) return;
    this.pressed = null;
    if (this.draft?.kind === "pose" && this.draft.yaw === null) this.draft.yaw = store.data("pose")?.yaw ?? 0;
    if (!this.draft || this.current !== this.draft.kind) return;
    // To let go is to confirm, as long as there is nothing to ask: what becomes of the goal that runs.
    if (this.draft.kind === "goal" && !asks && !store.isBusy()) this.confirm();
    else this.propose();
  }

  /** Ends the drawing of a zone: its corners can then be moved. */
  close() {
    this.draft.closed = true;
    this.corner = -1;
    this.propose();
  }

  /** Removes the corner that was held last. */
  removeCorner() {
    const { draft, corner } = this;
    if (draft?.kind !== "zone" || corner < 0 || draft.closed && draft.points.length < 4) return false;
    draft.points.splice(corner, 1);
    this.corner = -1;
    if (draft.points.length) this.propose();
    else this.drop();
    return true;
  }

  /** Takes a press back, and only that: a second finger came to move the map, or the system took the finger away. */
  abort() {
    if (!this.pressed) return;
    this.pressed = null;
    this.measure = null;
    this.corner = -1;
    if (!this.before) {
      this.drop();
      return;
    }
    const { draft, points, closed } = this.before;
    this.draft = draft;
    if (points) Object.assign(draft, { points, closed });
    this.propose();
  }

  /** Asks for the confirmation of a draft. */
  propose() {
    showDraft(this.draft);
    this.onchange();
  }

  drop() {
    this.draft = null;
    this.pressed = null;
    this.corner = -1;
    dropDraft();
    this.onchange();
  }

  async confirm() {
    if (!this.draft) return;
    if (this.draft.kind === "zone" && !this.draft.closed) {
      if (this.draft.points.length > 2) this.close();
      return;
    }
    const sent = this.draft;
    const { done, near } = await sendDraft(sent);
    if (this.draft !== sent) return;
    if (done) {
      this.drop();
      return;
    }
    // What was refused can be mended and sent again.
    if (near) Object.assign(sent, { x: near.x, y: near.y });
    this.propose();
  }
}

export const tools = new Tools();
// What was drawn for one robot is not sent to another.
store.on("watch", () => {
  if (tools.draft && tools.draft.robot !== store.watched) tools.drop();
});
