// API. How does the page ask the gateway? Each request has a deadline, each error a reason.

import { recall, remember } from "./memory.js";

const TOKEN = "zenav-token";
let held = null;

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** The gateway's token: out of the address (`#token=…`) once, then kept for this tab. */
export function token() {
  const found = /[#&]token=([^&]+)/.exec(location.hash);
  if (found) {
    history.replaceState(null, "", location.pathname);
    setToken(decoded(found[1]));
  }
  held ??= recall(TOKEN, "sessionStorage");
  return held;
}

export function setToken(value) {
  held = value;
  remember(TOKEN, value, "sessionStorage");
}

/** An error reply, or no reply. */
export class ApiError extends Error {
  constructor(status, body) {
    super(body?.reason ?? `the gateway answers ${status}`);
    this.status = status;
    this.body = body;
  }
}

/** What is under way, but for stops: a browser opens six connections to a gateway, and a stop waits for none. */
const others = new Set();

const CONNECTIONS = 6;

/** Of the six one is the WebSocket's, and one is the stop's own. */
function makeWay() {
  const most = CONNECTIONS - 2;
  if (others.size < most) return;
  for (const other of others) other.abort();
  others.clear();
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

export async function request(method, path, body, within = 12000) {
  const headers = {};
  const mine = new AbortController();
  if (/^(\/robots\/[^/]+)?\/stop$/.test(path)) makeWay();
  else others.add(mine);
  if (token()) headers.Authorization = `Bearer ${token()}`;
  if (body !== undefined) headers["Content-Type"] = "application/json";
  let reply;
  let answer;
  let isLate = false;
  const limit = setTimeout(() => {
    isLate = true;
    mine.abort();
  }, within);
  try {
    reply = await fetch(`/api/v1${path}`, {
      method, headers, body: body === undefined ? undefined : JSON.stringify(body), signal: mine.signal,
    });
    const text = await reply.text();
    answer = parsed(text);
  } catch (error) {
    let reason = "the gateway cannot be reached";
    if (isLate) reason = "the gateway does not answer";
    else if (error.name === "AbortError") reason = "a stop came before: whether it was done is not known";
    throw new ApiError(0, { reason });
  } finally {
    clearTimeout(limit);
    others.delete(mine);
  }
  if (!reply.ok) throw new ApiError(reply.status, answer);
  return answer;
}

const robotPath = (robot) => `/robots/${encodeURIComponent(robot)}`;

export const submitGoal = (robot, goal) => request("POST", `${robotPath(robot)}/goals`, goal);
export const cancelGoal = (robot, id) => request("DELETE", `${robotPath(robot)}/goals/${encodeURIComponent(id)}`);
export const pauseGoal = (robot, id) => request("POST", `${robotPath(robot)}/goals/${encodeURIComponent(id)}/pause`);
export const resumeGoal = (robot, id) => request("POST", `${robotPath(robot)}/goals/${encodeURIComponent(id)}/resume`);
/** Moves a waiting goal before another one; without one, to the end of the queue. */
export const moveGoal = (robot, id, before) => request("POST", `${robotPath(robot)}/goals/${encodeURIComponent(id)}/move`, { before });
export const setPose = (robot, pose) => request("POST", `${robotPath(robot)}/pose`, pose);
export const putPlace = (robot, name, place) => request("PUT", `${robotPath(robot)}/places/${encodeURIComponent(name)}`, place);
export const deletePlace = (robot, name) => request("DELETE", `${robotPath(robot)}/places/${encodeURIComponent(name)}`);
export const putZone = (robot, name, zone) => request("PUT", `${robotPath(robot)}/zones/${encodeURIComponent(name)}`, zone);
export const deleteZone = (robot, name) => request("DELETE", `${robotPath(robot)}/zones/${encodeURIComponent(name)}`);
export const listGoals = (robot) => request("GET", `${robotPath(robot)}/goals`);
export const stopRobot = (robot) => request("POST", `${robotPath(robot)}/stop`, undefined, 4000);
export const resumeRobot = (robot) => request("POST", `${robotPath(robot)}/resume`);
export const stopAll = () => request("POST", "/stop", undefined, 6000);

/** An id for a goal, made before it is first sent: the same goal sent twice is one goal. */
export function freshId() {
  const bytes = crypto.getRandomValues(new Uint8Array(8));
  return `goal-${Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("")}`;
}
