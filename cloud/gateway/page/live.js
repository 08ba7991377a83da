// Live link. How does the page keep its WebSocket? It connects again by itself, and says so.

import { setToken, token } from "./api.js";
import { ask } from "./dom.js";
import { recall, remember } from "./memory.js";
import { store } from "./store.js";

/** A gateway that says nothing for this long is taken for gone, ms: it speaks every second. */
const SILENCE = 4000;
let socket = null;
let heard = 0;
let wait = 250;
/** Whether this socket has brought anything: one that is refused never does. */
let greeted = false;
/** When the gateway was last asked to watch a robot, ms, and how soon it is asked again. */
let asked = 0;
const ASK_AGAIN = 1000;

export function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function askToWatch() {
  asked = performance.now();
  send({ type: "watch", robot: store.watched });
}

export function watch(robot) {
  if (store.watched !== robot) store.clearDetail();
  store.watched = robot;
  document.title = `${robot} · zenav mission control`;
  if (robot) remember("zenav-robot", robot);
  askToWatch();
  store.tell("watch");
}

function setState(state) {
  if (store.socket === state) return;
  store.socket = state;
  store.tell("socket");
}

async function reasonOfClose() {
  // A WebSocket does not tell why it was refused; a plain request does.
  const headers = token() ? { Authorization: `Bearer ${token()}` } : {};
  const reply = await fetch("/api/v1/health", { headers, signal: AbortSignal.timeout(3000) }).catch(() => null);
  return reply?.status;
}

async function retry() {
  setState("closed");
  const wasGreeted = greeted;
  greeted = false;
  const reason = await reasonOfClose();
  store.refused = reason === 200 && !wasGreeted;
  store.locked = reason === 401;
  if (reason === 401) {
    const given = await ask({
      title: "Token of the gateway", text: "This gateway needs a token: the first line of its token file.", yes: "Connect", field: "Token",
    });
    if (given) setToken(given);
  }
  setTimeout(connect, wait);
  wait = Math.min(wait * 1.6, 3000);
}

export function connect() {
  setState(store.socket === "closed" ? "closed" : "connecting");
  const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/live`;
  const protocols = ["zenav.v1"];
  if (token()) protocols.push(`bearer.${token()}`);
  let mine;
  try {
    mine = new WebSocket(address, protocols);
  } catch {
    // A token that no WebSocket can carry was never the gateway's.
    setToken("");
    protocols.length = 1;
    mine = new WebSocket(address, protocols);
  }
  socket = mine;
  heard = performance.now();
  mine.binaryType = "arraybuffer";
  mine.onmessage = (event) => {
    heard = performance.now();
    if (typeof event.data !== "string") {
      if (store.raster.take(event.data, store.watched)) store.tell("map");
      return;
    }
    take(JSON.parse(event.data));
  };
  mine.onclose = () => {
    if (socket === mine) lose();
  };
}

/** Gives the socket up at once: on a dead link a browser waits long for the other side to say goodbye. */
function lose() {
  const lost = socket;
  socket = null;
  lost.close();
  retry();
}

function take(message) {
  switch (message.type) {
    case "hello":
      wait = 250;
      greeted = true;
      store.refused = store.locked = false;
      store.hello(message);
      setState("open");
      if (store.watched) watch(store.watched);
      break;
    case "frame":
      store.frame(message);
      // The gateway did not know it when it was asked to watch it.
      if (store.fleet.includes(store.watched) && message.watched !== store.watched && performance.now() - asked > ASK_AGAIN) askToWatch();
      chooseRobot();
      break;
    case "pong":
      store.pings.push(performance.now() - message.t);
      store.pings.splice(0, store.pings.length - 30);
      break;
    case "teleop":
      store.teleop = message;
      store.tell("teleop");
      break;
    default:
      console.warn("gateway:", message);
  }
}

/** Watches the robot that was watched last, or the first. One that is watched stays so, heard or not: STOP must not go to another. */
function chooseRobot() {
  if (store.watched) return;
  const last = recall("zenav-robot");
  const robot = store.fleet.includes(last) ? last : store.fleet[0];
  if (robot) watch(robot);
}

setInterval(() => {
  send({ type: "ping", t: performance.now() });
  if (socket && performance.now() - heard > SILENCE) lose();
}, 1000);
