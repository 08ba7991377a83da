// Store. What does the page know? The newest of everything, with when the gateway heard it; the parts of the page look on.

import { Raster } from "./grid.js";

const MAX_EVENTS = 300;
const MAX_TRAIL = 4000;
/** Goals that ended are kept up to this many. */
const MAX_ENDED = 200;
/** A marker that was not told of for this long is gone, s. */
const MARKER = 30;
/** The quickest frame is one of the last one to two such times, s. */
const QUICKEST_OF = 120;
/** A robot that is silent for longer is shown as stale, s. */
export const STALE = 2;

const now = () => performance.now() / 1000;

class Store extends EventTarget {
  constructor() {
    super();
    /** `connecting`, `open` or `closed`: the link to the gateway. */
    this.socket = "connecting";
    /** Whether the gateway answers, but refuses the link: too many browsers, or an origin that it does not know. */
    this.refused = false;
    /** Whether it refuses it for want of its token. */
    this.locked = false;
    /** Whether the gateway reaches the bus. */
    this.connected = false;
    this.fleet = [];
    /** Robot to its channels `state`, `pose`, `parts`: `{ data, heard }`. */
    this.robots = new Map();
    this.watched = null;
    this.raster = new Raster();
    /** Places of the world, for a robot whose own are not known. */
    this.worldPlaces = {};
    this.teleop = { state: "released" };
    this.pings = [];
    /** A goal was just sent, and may not be told of yet until then, ms. */
    this.sentUntil = 0;
    /** The page's clock less the gateway's, s, as the quickest frame showed it: the later ones were longer on their way. */
    this.forgetLateness();
    this.clearDetail();
  }

  /** The gateway's clock now, s, as far as frames and pings tell. */
  gatewayTime() {
    if (!Number.isFinite(this.ahead)) return null;
    const oneWay = this.pings.length ? Math.min(...this.pings) / 2000 : 0;
    return now() - this.ahead + oneWay;
  }

  forgetLateness() {
    this.ahead = this.before = this.quickest = Infinity;
    this.since = now();
  }

  /** How much longer than the quickest one a frame was on its way, s. */
  lateness(message, at) {
    const ahead = at - message.now;
    // Clocks drift, and machines pause: the quickest one is of late.
    if (at - this.since > QUICKEST_OF) {
      this.before = this.quickest;
      this.quickest = Infinity;
      this.since = at;
    }
    this.quickest = Math.min(this.quickest, ahead);
    this.ahead = Math.min(this.before, this.quickest);
    return ahead - this.ahead;
  }

  clearDetail() {
    this.detail = new Map();
    this.goals = new Map();
    this.events = [];
    this.trail = [];
    this.raster.clear();
  }

  /** Tells whoever listens. */
  tell(topic) {
    this.dispatchEvent(new Event(topic));
  }

  on(topic, listener) {
    this.addEventListener(topic, listener);
  }

  /** Named places of the watched robot's map. */
  get places() {
    return this.data("annotations")?.places ?? this.worldPlaces;
  }

  /** Keep-out and speed zones of the watched robot's map. */
  get zones() {
    return this.data("annotations")?.zones ?? [];
  }

  /** A channel of a robot, or of the watched robot's details. */
  channel(name, robot = this.watched) {
    const summary = this.robots.get(robot)?.[name];
    return summary ?? (robot === this.watched ? this.detail.get(name) : undefined);
  }

  /** Names of the channels of the watched robot: its summary, then its details. */
  channels() {
    const summary = Object.keys(this.robots.get(this.watched) ?? {}).filter((name) => name !== "before");
    return [...summary, ...this.detail.keys()];
  }

  data(name, robot = this.watched) {
    return this.channel(name, robot)?.data;
  }

  /** Seconds since a channel was heard; infinite if never. */
  age(name, robot = this.watched) {
    const entry = this.channel(name, robot);
    return entry ? now() - entry.heard : Infinity;
  }

  isStale(robot = this.watched) {
    return this.socket !== "open" || this.age("state", robot) > STALE;
  }

  /** Whether there is a map that no mapping service keeps any more. */
  isMapOld() {
    return Boolean(this.raster.spec) && this.data("parts")?.includes("mapping") === false;
  }

  /** Seconds since the mapping service was first seen to be gone. */
  mapAge() {
    return now() - this.channel("parts")?.left;
  }

  /** Begins anew: the gateway may have been another one before. */
  hello(message) {
    this.worldPlaces = message.places ?? {};
    this.forgetLateness();
    this.robots.clear();
    this.clearDetail();
    this.tell("hello");
  }

  frame(message) {
    const at = now();
    const late = this.lateness(message, at);
    const heard = (entry) => ({ data: entry.data, heard: at - late - entry.age });
    this.connected = message.connected;
    if (message.fleet) {
      this.fleet = message.fleet;
      for (const robot of [...this.robots.keys()]) if (!this.fleet.includes(robot)) this.robots.delete(robot);
    }
    for (const [robot, channels] of Object.entries(message.robots)) {
      const known = this.robots.get(robot) ?? {};
      for (const [name, entry] of Object.entries(channels)) {
        const next = heard(entry);
        if (name === "pose") known.before = known.pose;
        // The list is told again whenever any part comes or goes.
        if (name === "parts" && !next.data.includes("mapping")) next.left = known.parts?.left ?? next.heard;
        known[name] = next;
      }
      this.robots.set(robot, known);
    }
    if (message.watched && message.watched === this.watched) {
      if (message.fresh) {
        this.detail = new Map();
        this.goals = new Map();
        this.events = [];
        this.trail = [];
      }
      for (const [name, entry] of Object.entries(message.detail)) this.detail.set(name, heard(entry));
      for (const goal of message.goals) this.goals.set(goal.id, goal);
      this.prune(at);
      if (message.events.length) {
        this.events.push(...message.events);
        this.events.splice(0, this.events.length - MAX_EVENTS);
        this.tell("events");
      }
      this.trail.push(...message.trail);
      this.trail.splice(0, this.trail.length - MAX_TRAIL);
    }
    if (message.fleet) this.tell("fleet");
    if (message.fresh) this.tell("fresh");
    this.tell("frame");
  }

  /** Forgets markers that nobody tells of any more, and goals that ended long ago. */
  prune(at) {
    for (const [name, entry] of this.detail) if (name.startsWith("marker/") && at - entry.heard > MARKER) this.detail.delete(name);
    if (this.goals.size <= 2 * MAX_ENDED) return;
    const ended = [...this.goals.values()].filter((goal) => Number.isFinite(goal.ended)).sort((a, b) => a.ended - b.ended);
    for (const goal of ended.slice(0, Math.max(0, ended.length - MAX_ENDED))) this.goals.delete(goal.id);
  }

  /** The running goal, if there is one. */
  runningGoal() {
    return [...this.goals.values()].find((goal) => goal.state === "Active" || goal.state === "Paused");
  }

  /** Whether a goal runs, waits, or has just been sent: another one would have to replace it or wait. */
  isBusy() {
    const open = ["Active", "Paused", "Accepted"];
    return performance.now() < this.sentUntil || [...this.goals.values()].some((goal) => open.includes(goal.state));
  }
}

export const store = new Store();
