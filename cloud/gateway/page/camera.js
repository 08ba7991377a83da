// Camera. Which part of the map shows? A centre in metres and a scale in pixels a metre; y points up.

const LEAST = 4;
const MOST = 1500;

export class Camera {
  constructor() {
    this.x = 0;
    this.y = 0;
    this.scale = 80;
    this.width = 1;
    this.height = 1;
  }

  toScreen(x, y) {
    return [(x - this.x) * this.scale + this.width / 2, this.height / 2 - (y - this.y) * this.scale];
  }

  toWorld(px, py) {
    return [(px - this.width / 2) / this.scale + this.x, (this.height / 2 - py) / this.scale + this.y];
  }

  zoomAt(px, py, factor) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(MOST, Math.max(LEAST, this.scale * factor));
    const [nx, ny] = this.toWorld(px, py);
    this.x += x - nx;
    this.y += y - ny;
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Shows an extent [x0, y0, x1, y1] in m with a border, beside the toolbar. */
  fit([x0, y0, x1, y1]) {
    const [left, right, upright] = [90, 40, 50];
    const scale = Math.min((this.width - left - right) / Math.max(x1 - x0, 0.5), (this.height - 2 * upright) / Math.max(y1 - y0, 0.5));
    this.scale = Math.min(MOST, Math.max(LEAST, scale));
    this.x = (x0 + x1) / 2 - (left - right) / 2 / this.scale;
    this.y = (y0 + y1) / 2;
  }

  /** A round length in m that is some 90 to 200 pixels long. */
  rule() {
    const about = 110 / this.scale;
    const power = 10 ** Math.floor(Math.log10(about));
    return [1, 2, 5, 10].map((step) => step * power).find((length) => length >= about) ?? power * 10;
  }
}
