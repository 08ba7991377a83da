// Send. How does what a person drew or typed reach the robot, and what are they told of it?

import * as api from "./api.js";
import { capital, degrees, toast } from "./dom.js";
import { store } from "./store.js";

/** A goal that was sent is told of by then, ms. */
const SENT_MS = 3000;

/** Does it; `false` after a refusal, which is told. */
export async function attempt(what, call) {
  try {
    await call();
    return true;
  } catch (error) {
    if (!(error instanceof api.ApiError)) throw error;
    toast(`${what}: ${error.message}`, "bad");
    return false;
  }
}

/** Submits a goal to the watched robot; what was refused may come with the nearest free place. */
export async function sendGoal(goal) {
  if (!store.watched) return { sent: false };
  let near = null;
  store.sentUntil = performance.now() + SENT_MS;
  const sent = await attempt("Goal refused", async () => {
    try {
      await api.submitGoal(store.watched, { id: api.freshId(), ...goal });
    } catch (error) {
      near = error.body?.nearest_free ?? null;
      throw error;
    }
  });
  if (sent) toast("Goal accepted", "good");
  else store.sentUntil = 0;
  return { sent, near };
}

export async function sendPose({ x, y, yaw }) {
  const robot = store.watched;
  const set = await attempt("Pose not set", () => api.setPose(robot, { x, y, yaw }));
  if (set) toast(`Pose of ${robot} set: ${x.toFixed(2)}, ${y.toFixed(2)} m, ${degrees(yaw)}°`, "good");
  return set;
}

/** Stores a thing under a name; one that had another name before loses that. */
async function save(kind, known, put, remove, original, name) {
  if (!name) {
    toast(`A ${kind} needs a name`, "bad");
    return false;
  }
  if (name !== original && known.includes(name)) {
    toast(`${capital(kind)} “${name}” exists already`, "bad");
    return false;
  }
  const saved = await attempt(`${capital(kind)} not saved`, async () => {
    await put();
    if (original && original !== name) await remove(original);
  });
  if (saved) toast(`${capital(kind)} “${name}” saved`, "good");
  return saved;
}

export function savePlace(original, name, place) {
  const robot = store.watched;
  return save("place", Object.keys(store.places), () => api.putPlace(robot, name, place), (old) => api.deletePlace(robot, old), original, name);
}

export function saveZone(original, name, zone) {
  const robot = store.watched;
  const known = store.zones.map((one) => one.name);
  return save("zone", known, () => api.putZone(robot, name, zone), (old) => api.deleteZone(robot, old), original, name);
}
