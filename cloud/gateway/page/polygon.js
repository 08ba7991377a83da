// Polygon. Which corner or side of a zone does a press take hold of?

const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

/** The corner within `reach` m of a point, or -1. */
export function cornerNear(points, at, reach) {
  let found = -1;
  points.forEach((point, index) => {
    if (distance(point, at) <= reach && (found < 0 || distance(point, at) < distance(points[found], at))) found = index;
  });
  return found;
}

/** The side within `reach` m of a point, as the index of its first corner, or -1. */
export function sideNear(points, at, reach) {
  return points.findIndex((from, index) => {
    const to = points[(index + 1) % points.length];
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    const length = dx * dx + dy * dy;
    const along = length > 0 ? ((at[0] - from[0]) * dx + (at[1] - from[1]) * dy) / length : 0;
    if (along < 0 || along > 1) return false;
    return distance(at, [from[0] + along * dx, from[1] + along * dy]) <= reach;
  });
}

/**
 * Corners out of text: two numbers a corner; null where it is none, or fewer than three. A comma right between two digits is refused: it may be
 * a decimal one.
 */
export function cornersOf(text) {
  if (/\d,\d/.test(text)) return null;
  const words = text.trim().split(/[\s,;]+/);
  const numbers = words.map(Number);
  if (words.length < 6 || words.length % 2 || !numbers.every(Number.isFinite)) return null;
  return Array.from({ length: numbers.length / 2 }, (_, at) => numbers.slice(2 * at, 2 * at + 2));
}
