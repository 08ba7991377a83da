// Memory. What does the page remember from one visit to the next? A browser may forbid it: the page, and its STOP, work without.

/** Text kept under a name in this browser, or in this tab; null if there is none. */
export function recall(name, storage = "localStorage") {
  try {
    return window[storage].getItem(name);
  } catch {
    return null;
  }
}

/** Keeps a text under a name, where the browser allows it. */
export function remember(name, text, storage = "localStorage") {
  try {
    window[storage].setItem(name, text);
  } catch {
    // Forbidden, or full: it is forgotten.
  }
}

/** A kept value; `otherwise` if there is none that can be read. */
export function recallJson(name, otherwise) {
  try {
    return JSON.parse(recall(name)) ?? otherwise;
  } catch {
    return otherwise;
  }
}
