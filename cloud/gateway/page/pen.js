// Pen. Which shapes do several layers draw?

const TAU = 2 * Math.PI;

/** A line through `points`, numbers of which every `step`th begins an x, y. */
export function path(context, camera, points, step = 2) {
  context.beginPath();
  for (let at = 0; at + 1 < points.length; at += step) context.lineTo(...camera.toScreen(points[at], points[at + 1]));
}

/** Most letters of a name on the map: the rest of a longer one stands in the panels. */
const LETTERS = 32;

export function label(context, colours, words, x, y, colour) {
  const letters = [...words];
  const text = letters.length > LETTERS ? `${letters.slice(0, LETTERS - 1).join("")}…` : words;
  context.font = "600 12px system-ui, 'DejaVu Sans', sans-serif";
  context.lineWidth = 3.5;
  context.lineJoin = "round";
  context.strokeStyle = colours["map-free"];
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** An arrow from a ring of `radius` pixels around a point, in the direction of `yaw`. */
export function arrow(context, [x, y], radius, yaw) {
  const [cos, sin] = [Math.cos(yaw), -Math.sin(yaw)];
  const tip = radius + 26;
  context.beginPath();
  context.moveTo(x + cos * radius, y + sin * radius);
  context.lineTo(x + cos * (tip - 6), y + sin * (tip - 6));
  context.stroke();
  context.beginPath();
  context.moveTo(x + cos * tip, y + sin * tip);
  context.lineTo(x + cos * (tip - 11) - sin * 6, y + sin * (tip - 11) + cos * 6);
  context.lineTo(x + cos * (tip - 11) + sin * 6, y + sin * (tip - 11) - cos * 6);
  context.fill();
}

/** A goal: a ring, and an arrow for its heading. */
export function drawGoal(context, camera, colour, goal, { dashed = false, text = "" } = {}, colours) {
  const at = camera.toScreen(goal.x, goal.y);
  const radius = Math.max(9, Math.min(18, camera.scale * 0.12));
  context.strokeStyle = colour;
  context.fillStyle = colour;
  context.lineWidth = 3;
  context.setLineDash(dashed ? [5, 4] : []);
  context.beginPath();
  context.arc(...at, radius, 0, TAU);
  context.stroke();
  context.setLineDash([]);
  context.beginPath();
  context.arc(...at, 3, 0, TAU);
  context.fill();
  if (goal.yaw !== null && goal.yaw !== undefined) arrow(context, at, radius, goal.yaw);
  if (text) label(context, colours, text, at[0] + radius + 6, at[1] - radius, colour);
}

/** A place: a diamond with its name, and a small arrow where it has a heading. */
export function drawPlace(context, camera, colours, name, place) {
  const [x, y] = camera.toScreen(place.x, place.y);
  context.fillStyle = context.strokeStyle = colours.place;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(x, y - 6);
  context.lineTo(x + 6, y);
  context.lineTo(x, y + 6);
  context.lineTo(x - 6, y);
  context.fill();
  if (place.yaw !== null && place.yaw !== undefined) {
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + 16 * Math.cos(place.yaw), y - 16 * Math.sin(place.yaw));
    context.stroke();
  }
  label(context, colours, name, x + 10, y + 4, colours.place);
}

/** A zone: keep-out in red, a speed limit in amber with its figure. */
export function drawZone(context, camera, colours, { name, limit, points, closed = true }) {
  const colour = limit === null ? colours.bad : colours.warn;
  path(context, camera, points.flat());
  if (closed) context.closePath();
  context.globalAlpha = 0.18;
  context.fillStyle = colour;
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.setLineDash([6, 4]);
  context.stroke();
  context.setLineDash([]);
  const middle = [0, 1].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
  const [x, y] = camera.toScreen(middle[0], middle[1]);
  context.textAlign = "center";
  if (name) label(context, colours, limit === null ? name : `${name}: ${limit} m/s`, x, y + 4, colour);
  context.textAlign = "start";
}
