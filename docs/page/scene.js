// The picture of the arm in 3-D, on two canvases: the floor, drawn when the view changes, and the arm. Drawn in strokes, which
// takes a phone or a computer without a graphics card about a millisecond. Positions in m, z away from the plate.

export const COLOURS = ["#D55E00", "#009E73", "#0072B2", "#E69F00"]; // tubes, inner to outer, as in all pictures of tubeopt
const THINNEST = [3.5, 1.5]; // px, of the innermost tube, and more of each around it: true diameters where they are larger

const SPREAD = 0.4; // half the height of what is seen at distance 1
const LAMP = [-0.55, 0.83]; // on the screen, x and up: where the light comes from

const add = (a, b, t = 1) => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];
const sub = (a, b) => add(a, b, -1);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => {
  const size = norm(a) || 1;
  return [a[0] / size, a[1] / size, a[2] / size];
};

/** A colour made darker (below 1) or lighter (above 1). */
function shade(hex, by) {
  const parts = [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  return `rgb(${parts.map((c) => Math.round(by < 1 ? c * by : c + (255 - c) * (by - 1))).join(",")})`;
}

/** Points of a curve with an axis across it that does not turn about the curve, from the x axis of the plate. */
function carried(points) {
  const count = points.length / 3, at = (k) => [points[3 * k], points[3 * k + 1], points[3 * k + 2]];
  const out = [];
  let x = [1, 0, 0], tangent = [0, 0, 1];
  for (let k = 0; k < count; k++) {
    const ahead = k + 1 < count ? sub(at(k + 1), at(k)) : sub(at(k), at(k - 1));
    const both = k > 0 ? add(ahead, sub(at(k), at(k - 1))) : [0, 0, 1];
    const next = norm(both) > 0 ? unit(both) : tangent;
    const axis = cross(tangent, next), c = dot(tangent, next);
    if (norm(axis) > 1e-12) x = add(add(add([0, 0, 0], x, c), cross(axis, x)), axis, dot(axis, x) / (1 + c));
    tangent = next;
    out.push({ at: at(k), x, y: cross(tangent, x) });
  }
  return out;
}

/** Stretches of the tubes of an arm, each from where the one around it ends: tube, two places, and where its mark is. */
function stretches({ points, length, turned }, ends) {
  const curve = carried(points), last = curve.length - 1, out = [];
  const place = (s) => {
    const where = length > 0 ? Math.min(Math.max(s / length, 0), 1) * last : 0, k = Math.min(Math.floor(where), last - 1);
    return { at: add(curve[k].at, sub(curve[k + 1].at, curve[k].at), where - k), k };
  };
  for (let i = ends.length - 1; i >= 0; i--) {
    const from = Math.max(0, ends[i + 1] ?? 0), to = Math.min(ends[i], length);
    if (!(to > from + 1e-9)) continue;
    const places = [place(from)];
    for (let k = 0; k <= last; k++) {
      const s = (length * k) / last;
      if (s > from + 1e-9 && s < to - 1e-9) places.push({ at: curve[k].at, k });
    }
    places.push(place(to));
    for (let p = 0; p + 1 < places.length; p++) {
      const { x, y } = curve[places[p].k], angle = turned?.[places[p].k][i];
      const mark = turned ? add(add([0, 0, 0], x, Math.cos(angle)), y, Math.sin(angle)) : null;
      out.push({ tube: i, from: places[p].at, to: places[p + 1].at, mark });
    }
  }
  return out;
}

export class Scene {
  constructor(canvas, floor, theme) {
    this.canvas = canvas;
    this.floor = floor;
    this.theme = theme;
    this.camera = { centre: [0, 0, 0.09], distance: 0.55, azimuth: -0.9, elevation: 0.32 };
    this.arm = this.ghost = null;
    this.handles = { tip: [0, 0, 0] };
  }

  setArm(picture, ends, radii) {
    this.arm = { parts: stretches(picture, ends), radii };
  }

  /** Where the arm was before a snap; null takes it away. */
  setGhost(picture, radii, alpha) {
    this.ghost = picture && { points: picture.points, radius: radii[0], alpha };
  }

  /** The tip as a handle, what it is drawn to, and an arrow for the force on it. */
  setHandles(handles) {
    this.handles = handles;
  }

  /** The camera so that the whole of an arm of a length is seen. */
  frame(length) {
    const size = Math.max(length, 0.04), narrow = this.canvas.clientWidth < 600; // there the readout is over the arm
    Object.assign(this.camera, { centre: [0, 0, (narrow ? 0.5 : 0.42) * size], distance: (narrow ? 2.15 : 2.2) * size });
  }

  // --- the camera: right, up and towards the eye are directions on the screen ---------------------------------------------

  look() {
    const { centre, distance, azimuth, elevation } = this.camera, c = Math.cos(elevation);
    const towards = [c * Math.cos(azimuth), c * Math.sin(azimuth), Math.sin(elevation)];
    const right = unit(cross([0, 0, 1], towards));
    const { clientWidth: w, clientHeight: h } = this.canvas;
    return { eye: add(centre, towards, distance), right, up: cross(towards, right), towards, w, h };
  }

  /** Pixels of the page from the upper left corner of the canvas, and pixels per metre there. */
  project(point, { eye, right, up, towards, w, h } = this.look()) {
    const from = sub(point, eye), scale = h / (2 * SPREAD * Math.max(-dot(from, towards), 1e-3));
    return [w / 2 + dot(from, right) * scale, h / 2 - dot(from, up) * scale, scale];
  }

  /** A point moved by pixels, in the plane of the screen. */
  moved(point, dx, dy) {
    const look = this.look(), scale = this.project(point, look)[2];
    return add(add(point, look.right, dx / scale), look.up, -dy / scale);
  }

  orbit(dx, dy) {
    this.camera.azimuth -= 0.008 * dx;
    this.camera.elevation = Math.min(Math.max(this.camera.elevation + 0.008 * dy, -0.1), 1.5);
  }

  zoom(factor) {
    this.camera.distance = Math.min(Math.max(this.camera.distance * factor, 0.03), 4);
  }

  // --- drawing ------------------------------------------------------------------------------------------------------------

  draw() {
    const look = this.look(), ratio = Math.min(window.devicePixelRatio || 1, 2);
    const view = [look.eye, look.right, look.w, look.h, ratio, this.theme.grid].join();
    if (view !== this.drawn) {
      this.drawn = view;
      this.#drawFloor(this.#context(this.floor, look, ratio), look);
    }
    const context = this.#context(this.canvas, look, ratio);
    if (this.ghost) this.#drawGhost(context, look);
    this.#drawArm(context, look);
    this.#drawHandles(context, look);
  }

  #context(canvas, { w, h }, ratio) {
    const [wide, high] = [Math.round(w * ratio), Math.round(h * ratio)];
    if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, w, h);
    return context;
  }

  /** Squares of 1 and 5 cm, the plate, and its axes, 2 cm beyond it. */
  #drawFloor(context, look) {
    const line = (a, b) => {
      // What is behind the eye is cut off.
      const depth = (p) => -dot(sub(p, look.eye), look.towards), [da, db] = [depth(a), depth(b)], near = 0.01;
      if (da < near && db < near) return;
      const cut = (p, q, dp, dq) => (dp >= near ? p : add(p, sub(q, p), (near - dp) / (dq - dp)));
      context.moveTo(...this.project(cut(a, b, da, db), look).slice(0, 2));
      context.lineTo(...this.project(cut(b, a, db, da), look).slice(0, 2));
    };
    context.strokeStyle = this.theme.grid;
    for (const [every, alpha] of [[1, 0.22], [5, 0.5]]) {
      context.globalAlpha = alpha;
      context.lineWidth = 1;
      context.beginPath();
      for (let k = -15; k <= 15; k += every) {
        line([0.01 * k, -0.15, 0], [0.01 * k, 0.15, 0]);
        line([-0.15, 0.01 * k, 0], [0.15, 0.01 * k, 0]);
      }
      context.stroke();
    }
    context.globalAlpha = 1;
    for (const [z, colour] of [[-0.004, shade(this.theme.plate, 0.75)], [0, this.theme.plate]]) {
      context.fillStyle = colour;
      context.beginPath();
      for (let k = 0; k < 48; k++) {
        const [x, y] = this.project([0.012 * Math.cos((k * Math.PI) / 24), 0.012 * Math.sin((k * Math.PI) / 24), z], look);
        context.lineTo(x, y);
      }
      context.fill();
    }
    for (const [way, colour, name] of [[[1, 0, 0], "#c8442e", "x"], [[0, 1, 0], "#3d9a46", "y"]])
      this.#arrow(context, this.project(add([0, 0, 0], way, 0.012), look), this.project(add([0, 0, 0], way, 0.034), look), 1.6, colour, name);
  }

  #arrow(context, [x0, y0], [x1, y1], width, colour, name) {
    const length = Math.hypot(x1 - x0, y1 - y0) || 1, [dx, dy] = [(x1 - x0) / length, (y1 - y0) / length];
    const head = Math.min(6 * width, length), [bx, by] = [x1 - head * dx, y1 - head * dy], side = 2.2 * width;
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = width;
    context.lineCap = "butt";
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(bx, by);
    context.stroke();
    context.beginPath();
    context.moveTo(x1, y1);
    context.lineTo(bx - side * dy, by + side * dx);
    context.lineTo(bx + side * dy, by - side * dx);
    context.fill();
    if (!name) return;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(name, x1 + 9 * dx, y1 + 9 * dy);
  }

  #drawGhost(context, look) {
    const { points, radius, alpha } = this.ghost;
    context.beginPath();
    let scale = 1;
    for (let k = 0; k < points.length; k += 3) {
      const [x, y, here] = this.project([points[k], points[k + 1], points[k + 2]], look);
      context.lineTo(x, y);
      scale = here;
    }
    context.globalAlpha = alpha;
    context.strokeStyle = this.theme.ghost;
    context.lineWidth = Math.max(2 * radius * scale, THINNEST[0]);
    context.lineJoin = context.lineCap = "round";
    context.stroke();
    context.globalAlpha = 1;
  }

  /** From the farthest stretch to the nearest; each as a dark stroke, a lit one, a bright one, and the mark of its tube. */
  #drawArm(context, look) {
    const { parts, radii } = this.arm;
    const seen = parts.map((part) => {
      const [x0, y0, s0] = this.project(part.from, look), [x1, y1, s1] = this.project(part.to, look);
      return { ...part, x0, y0, x1, y1, scale: (s0 + s1) / 2 };
    });
    seen.sort((a, b) => a.scale - b.scale);
    context.lineCap = "butt";
    for (const { tube, mark, x0, y0, x1, y1, scale } of seen) {
      const width = Math.max(2 * radii[tube] * scale, THINNEST[0] + THINNEST[1] * tube), length = Math.hypot(x1 - x0, y1 - y0) || 1;
      const [dx, dy] = [(x1 - x0) / length, (y1 - y0) / length];
      const lit = (-dy * LAMP[0] - dx * LAMP[1]) * width; // how far to the side the light falls
      const stroke = (aside, share, colour) => {
        // Over the seam to what lies behind: the lit strokes farther than the dark one, which would be seen as ribs.
        const [ox, oy] = Array.isArray(aside) ? aside : [-dy * aside, dx * aside], more = share < 1 ? 1.6 : 0.4;
        context.strokeStyle = colour;
        context.lineWidth = share * width;
        context.beginPath();
        context.moveTo(x0 + ox - more * dx, y0 + oy - more * dy);
        context.lineTo(x1 + ox + more * dx, y1 + oy + more * dy);
        context.stroke();
      };
      const colour = COLOURS[tube];
      stroke(0, 1, shade(colour, 0.72));
      stroke(0.14 * lit, 0.7, colour);
      stroke(0.2 * lit, 0.25, shade(colour, 1.35));
      const facing = mark ? dot(mark, look.towards) : 0, out = 0.47 * width;
      if (facing > 0.2) stroke([dot(mark, look.right) * out, -dot(mark, look.up) * out], 0.22 * facing, shade(colour, 0.3));
    }
  }

  #drawHandles(context, look) {
    const { tip, target, force, active } = this.handles, at = this.project(tip, look);
    if (target) {
      const [x, y] = this.project(target, look);
      context.strokeStyle = this.theme.handle;
      context.lineWidth = 1.5;
      context.setLineDash([4, 4]);
      context.beginPath();
      context.moveTo(at[0], at[1]);
      context.lineTo(x, y);
      context.stroke();
      context.setLineDash([]);
      context.beginPath();
      context.arc(x, y, 7, 0, 7);
      context.stroke();
    }
    if (force) this.#arrow(context, at, this.project(add(tip, force), look), 3, "#c2185b");
    context.beginPath();
    context.arc(at[0], at[1], active ? 10 : 8, 0, 7);
    context.fillStyle = this.theme.knob;
    context.fill();
    context.lineWidth = 2.5;
    context.strokeStyle = this.theme.handle;
    context.stroke();
  }
}
