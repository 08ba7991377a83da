// Map raster. How do tiles of occupancy become a picture? One pixel a cell, drawn at any scale; values are kept for the clearance.

const TILE = 64;
const UNKNOWN = 255;
/** Clearance beyond this is not told apart, m. */
export const FAR = 1.5;
/** Colour of a clearance that is this share of `FAR`: red, green, blue, opacity. */
const colourOf = (share) => [255 * (1 - share), 90 + 110 * share, 80 + 175 * share, 170 * (1 - share) + 20].map(Math.round);
/** Colours of clearance from 0 to `FAR`, as CSS. */
export const NEAR_TO_FAR = [0, 0.25, 0.5, 0.75, 1].map(colourOf).map(([red, green, blue, opacity]) => `rgb(${red} ${green} ${blue} / ${opacity / 255})`);

function rgb(text) {
  const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  probe.fillStyle = text;
  probe.fillRect(0, 0, 1, 1);
  return probe.getImageData(0, 0, 1, 1).data;
}

export class Raster {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.context = this.canvas.getContext("2d");
    this.clear();
    this.setColours({ unknown: "#1a222c", free: "#2c3744", wall: "#e8eef5" });
  }

  clear() {
    this.spec = null;
    this.values = null;
    this.clearance = null;
    this.clearanceIsOld = false;
    this.clearanceDue = 0;
    this.revision = 0;
  }

  setColours({ unknown, free, wall }) {
    this.palette = [];
    const [from, to] = [rgb(free), rgb(wall)];
    for (let value = 0; value <= 100; value += 1) {
      // What is surely free or surely a wall shows as such.
      const share = value < 20 ? 0 : value > 65 ? 1 : (value - 20) / 45;
      this.palette[value] = [0, 1, 2].map((part) => Math.round(from[part] + (to[part] - from[part]) * share));
    }
    this.palette[UNKNOWN] = [...rgb(unknown)].slice(0, 3);
    if (this.values) this.repaint();
  }

  /** Takes a message of the gateway: header, then 4096 bytes a tile. `true` when the picture changed. */
  take(buffer, robot) {
    const length = new DataView(buffer).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    if (header.robot !== robot) return false;
    this.fit(header);
    let at = 4 + length;
    for (const [x, y] of header.tiles) {
      this.write(x, y, new Uint8Array(buffer, at, TILE * TILE));
      at += TILE * TILE;
    }
    this.revision = header.revision;
    this.clearanceIsOld = true;
    return true;
  }

  /** Makes room for the map's geometry; what is known already keeps its place. */
  fit(header) {
    const spec = { origin: header.origin, resolution: header.resolution, width: header.width, height: header.height, id: header.id };
    const old = this.spec;
    const same = old && old.id === spec.id && old.width === spec.width && old.height === spec.height && old.origin[0] === spec.origin[0] && old.origin[1] === spec.origin[1];
    if (same) return;
    const values = new Uint8Array(spec.width * spec.height).fill(UNKNOWN);
    if (old && old.id === spec.id && old.resolution === spec.resolution) {
      const dx = Math.round((old.origin[0] - spec.origin[0]) / spec.resolution);
      const dy = Math.round((old.origin[1] - spec.origin[1]) / spec.resolution);
      const first = Math.max(0, -dx);
      const end = Math.min(old.width, spec.width - dx);
      for (let row = Math.max(0, -dy); row < Math.min(old.height, spec.height - dy) && first < end; row += 1) {
        values.set(this.values.subarray(row * old.width + first, row * old.width + end), (row + dy) * spec.width + first + dx);
      }
    }
    this.spec = spec;
    this.values = values;
    this.canvas.width = spec.width;
    this.canvas.height = spec.height;
    this.repaint();
  }

  write(tileX, tileY, cells) {
    const { width, height } = this.spec;
    const [x, y] = [tileX * TILE, tileY * TILE];
    const columns = Math.min(TILE, width - x);
    const rows = Math.min(TILE, height - y);
    if (columns <= 0 || rows <= 0) return;
    for (let row = 0; row < rows; row += 1) {
      this.values.set(cells.subarray(row * TILE, row * TILE + columns), (y + row) * width + x);
    }
    this.paint(x, y, columns, rows);
  }

  /** Paints cells from their values; the picture's rows run from the top. */
  paint(x, y, columns, rows) {
    const { width, height } = this.spec;
    const image = this.context.createImageData(columns, rows);
    for (let row = 0; row < rows; row += 1) {
      const from = (y + rows - 1 - row) * width + x;
      for (let column = 0; column < columns; column += 1) {
        const value = this.values[from + column];
        const colour = this.palette[value] ?? this.palette[UNKNOWN];
        const pixel = (row * columns + column) * 4;
        image.data[pixel] = colour[0];
        image.data[pixel + 1] = colour[1];
        image.data[pixel + 2] = colour[2];
        image.data[pixel + 3] = value === UNKNOWN ? 0 : 255;
      }
    }
    this.context.putImageData(image, x, height - y - rows);
  }

  repaint() {
    this.paint(0, 0, this.spec.width, this.spec.height);
  }

  /** Extent of the cells that are known: [x0, y0, x1, y1] in m, or null. */
  known() {
    if (!this.spec) return null;
    const { width, height, origin, resolution } = this.spec;
    let [x0, y0, x1, y1] = [width, height, -1, -1];
    for (let row = 0; row < height; row += 1) {
      for (let column = 0; column < width; column += 1) {
        if (this.values[row * width + column] === UNKNOWN) continue;
        if (column < x0) x0 = column;
        if (column > x1) x1 = column;
        if (row < y0) y0 = row;
        if (row > y1) y1 = row;
      }
    }
    if (x1 < 0) return null;
    return [origin[0] + x0 * resolution, origin[1] + y0 * resolution, origin[0] + (x1 + 1) * resolution, origin[1] + (y1 + 1) * resolution];
  }

  /**
   * A picture of the distance to the nearest occupied cell, with the map's geometry at that time: made when it is asked for. While the map keeps
   * changing, making it takes at most a tenth of the time: the page must stay quick to stop a robot.
   */
  clearancePicture() {
    const now = performance.now();
    if (!this.clearance || this.clearanceIsOld && now >= this.clearanceDue) {
      this.clearance = { picture: this.drawClearance(), spec: this.spec };
      this.clearanceIsOld = false;
      this.clearanceDue = now + 10 * (performance.now() - now);
    }
    return this.clearance;
  }

  /** The distance of each cell to the nearest occupied one, as a picture (Felzenszwalb and Huttenlocher, 2012). */
  drawClearance() {
    const { width, height, resolution } = this.spec;
    const far = 1e9;
    const field = new Float64Array(width * height);
    for (let at = 0; at < field.length; at += 1) field[at] = this.values[at] !== UNKNOWN && this.values[at] > 65 ? 0 : far;
    const length = Math.max(width, height);
    const [line, out, place, bound] = [new Float64Array(length), new Float64Array(length), new Int32Array(length), new Float64Array(length + 1)];
    const envelope = (count) => {
      let last = 0;
      place[0] = 0;
      bound[0] = -Infinity;
      bound[1] = Infinity;
      for (let q = 1; q < count; q += 1) {
        let cut = (line[q] + q * q - (line[place[last]] + place[last] ** 2)) / (2 * (q - place[last]));
        while (cut <= bound[last]) {
          last -= 1;
          cut = (line[q] + q * q - (line[place[last]] + place[last] ** 2)) / (2 * (q - place[last]));
        }
        last += 1;
        place[last] = q;
        bound[last] = cut;
        bound[last + 1] = Infinity;
      }
      for (let q = 0, k = 0; q < count; q += 1) {
        while (bound[k + 1] < q) k += 1;
        out[q] = (q - place[k]) ** 2 + line[place[k]];
      }
    };
    for (let x = 0; x < width; x += 1) {
      for (let y = 0; y < height; y += 1) line[y] = field[y * width + x];
      envelope(height);
      for (let y = 0; y < height; y += 1) field[y * width + x] = out[y];
    }
    const canvas = document.createElement("canvas");
    canvas.width = width;
    canvas.height = height;
    const context = canvas.getContext("2d");
    const image = context.createImageData(width, height);
    for (let y = 0; y < height; y += 1) {
      for (let x = 0; x < width; x += 1) line[x] = field[y * width + x];
      envelope(width);
      for (let x = 0; x < width; x += 1) {
        const value = this.values[y * width + x];
        const metres = Math.sqrt(out[x]) * resolution;
        const pixel = ((height - 1 - y) * width + x) * 4;
        if (value === UNKNOWN || value > 65 || metres > FAR) continue;
        image.data.set(colourOf(metres / FAR), pixel);
      }
    }
    context.putImageData(image, 0, 0);
    return canvas;
  }
}
