// The controls beside the picture. Each part has a function that shows what the arm is now.

import { DEG, MM, shiftRange } from "./robot.js";
import { COLOURS } from "./scene.js";
import { drawMap, WINDOW } from "./map.js";

/** An element with properties, style variables (--name) and children. */
export function make(tag, properties = {}, ...children) {
  const out = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key.startsWith("--")) out.style.setProperty(key, value);
    else if (key.startsWith("aria-") || key.startsWith("data-")) out.setAttribute(key, value);
    else out[key] = value;
  }
  out.append(...children);
  return out;
}

/** A slider with a field for exact values; `changed` gets the number. */
function slider({ name, unit, min, max, step, value = 0, colour, label = name, changed }) {
  const range = make("input", { type: "range", min, max, step, value, "aria-label": `${label}, ${unit}`, "--own": colour ?? "" });
  const field = make("input", { type: "number", step: "any", value, "aria-label": `${label}, ${unit}, exactly` });
  const row = make("div", { className: "row" }, make("span", {}, name), range, field, make("span", { className: "unit" }, unit));
  range.oninput = () => {
    field.value = range.value;
    changed(Number(range.value));
  };
  field.onchange = () => field.value !== "" && Number.isFinite(Number(field.value)) && changed(Number(field.value));
  return {
    row,
    show(number, digits) {
      if (document.activeElement !== range) range.value = number;
      if (document.activeElement !== field) field.value = number.toFixed(digits);
    },
    zones({ blocked = [min, max], snaps = blocked }) {
      // What begins at an end of the range is not seen, also beside the track's ends, where the knob does not go.
      const share = (x) => (x <= min ? -1 : x >= max ? 2 : (x - min) / (max - min));
      const values = { "--b0": blocked[0], "--s0": Math.max(snaps[0], blocked[0]), "--s1": Math.min(snaps[1], blocked[1]), "--b1": blocked[1] };
      for (const [key, x] of Object.entries(values)) range.style.setProperty(key, share(x).toFixed(4));
    },
  };
}

const part = (name, title, ...children) => {
  const out = make("section", { className: "part" }, make("h2", {}, title), ...children);
  out.dataset.part = name;
  return out;
};

const heading = (i, text, ...more) => make("h3", {}, make("i", { "--own": COLOURS[i], style: `background:${COLOURS[i]}` }), text, ...more);

/** Rotations and translations. */
export function jointsPart(tubes, actions) {
  const rows = { rotations: [], translations: [] };
  const home = make("button", { onclick: actions.home }, "Home");
  const out = part("joints", "Joints");
  out.querySelector("h2").append(home);
  tubes.forEach((tube, i) => {
    const own = { colour: COLOURS[i] };
    const turn = slider({ ...own, name: "rotation", label: `rotation of tube ${i + 1}`, unit: "°", min: tube.turnRange[0] / DEG, max: tube.turnRange[1] / DEG, step: 0.1, changed: (x) => actions.joint("rotations", i, x * DEG) });
    const shift = slider({ ...own, name: "translation", label: `translation of tube ${i + 1}`, unit: "mm", min: tube.shiftRange[0] / MM, max: tube.shiftRange[1] / MM, step: 0.1, changed: (x) => actions.joint("translations", i, x * MM) });
    rows.rotations.push(turn);
    rows.translations.push(shift);
    out.append(heading(i, `Tube ${i + 1}${tubes.length > 1 ? (i ? (i + 1 === tubes.length ? ", outermost" : "") : ", innermost") : ""}`), turn.row, shift.row);
  });
  out.append(make("p", { className: "note" }, "Red: the arm snaps if this joint alone moves there. Pale: other tubes are in the way."));
  return {
    out,
    show({ rotations, translations }, ahead) {
      tubes.forEach((tube, i) => {
        rows.rotations[i].show(rotations[i] / DEG, 1);
        rows.translations[i].show(translations[i] / MM, 2);
        const range = shiftRange(tubes, translations, i);
        const snaps = (kind, [low, high], unit) => [(ahead?.[kind][i][0] ?? low) / unit, (ahead?.[kind][i][1] ?? high) / unit];
        const blocked = range.map((d) => d / MM);
        rows.rotations[i].zones({ snaps: snaps("rotations", tube.turnRange, DEG) });
        rows.translations[i].zones({ blocked, snaps: snaps("translations", range, MM) });
      });
    },
  };
}

/** What dragging the tip does, the least margin on the way, and the load. */
export function tipPart(actions, mode, floor) {
  const modes = ["move", "push"].map((word) =>
    make("button", { onclick: () => actions.mode(word), "aria-pressed": word === mode }, word === "move" ? "Drag moves the tip" : "Drag pushes the tip"));
  const least = slider({ name: "least margin", label: "least margin while the tip is moved", unit: "", min: 0, max: 0.95, step: 0.01, value: floor, changed: actions.floor });
  least.show(floor, 2);
  const axes = ["x", "y", "z"].map((name, k) =>
    slider({ name: `force ${name}`, label: `force on the tip along ${name}`, unit: "mN", min: -50, max: 50, step: 0.1, changed: (x) => actions.force(k, x * MM) }));
  const off = make("button", { onclick: () => actions.force(null) }, "Remove");
  const loadHead = make("h3", {}, "Force on the tip", off);
  const said = make("p", { className: "note" });
  const out = part("tip", "Tip and load", make("div", { className: "modes" }, ...modes), least.row, loadHead, ...axes.map((a) => a.row), said);
  return {
    out,
    show(force, moved) {
      axes.forEach((axis, k) => axis.show(force[k] / MM, 2));
      const size = Math.hypot(...force);
      off.disabled = !size;
      said.textContent = size ? `${(size / MM).toFixed(2)} mN move the tip by ${(moved / MM).toFixed(2)} mm.` : "No load. A force keeps its direction while the arm bends.";
    },
    mode(word) {
      modes.forEach((button, k) => button.setAttribute("aria-pressed", ["move", "push"][k] === word));
    },
  };
}

/** Certificate and energy map. */
export function stabilityPart(n, actions) {
  const number = make("b"), words = make("span"), proof = make("div", { className: "proof" }, number, words);
  const canvas = make("canvas", { width: 480, height: 480, "aria-label": "Energy over the twists of two tubes" });
  const x = make("span", { className: "x" }), y = make("span", { className: "y" });
  const pairs = [];
  for (let i = 0; i < n; i++) for (let j = i + 1; j < n; j++) pairs.push([i, j]);
  const choose = make("select", { "aria-label": "Tubes of the map", onchange: () => actions.pair(pairs[choose.value]) });
  pairs.forEach(([i, j], k) => choose.append(make("option", { value: k }, `tubes ${i + 1} and ${j + 1}`)));
  const figure = make("figure", {}, y, canvas, x);
  const none = make("p", { className: "note" });
  const out = part("stability", "Stability", proof, make("h3", {}, "Energy map", ...(pairs.length > 1 ? [choose] : [])), figure, none);
  let pair = pairs[0];
  canvas.onclick = ({ offsetX, offsetY }) => {
    const share = [offsetX / canvas.clientWidth, 1 - offsetY / canvas.clientHeight];
    actions.fall(pair, share.map((x) => (2 * x - 1) * WINDOW));
  };
  return {
    out,
    pair: () => pair,
    choose(next) {
      pair = next;
    },
    certificate(mu) {
      number.textContent = Number.isFinite(mu) ? mu.toFixed(3).replace("-", "−") : "–";
      proof.className = `proof ${mu > 0 ? "yes" : "no"}`;
      words.textContent = mu > 0
        ? "Certificate above 0: at these translations no rotations can make this robot snap."
        : n > 2
          ? "Certificate not above 0: snaps are not excluded at these translations."
          : "Certificate not above 0: at these translations this pair snaps if it is turned far enough.";
    },
    map(data, pose) {
      const shown = Boolean(data?.map);
      figure.hidden = !shown;
      none.textContent = shown
        ? "Least energy with the tips of both tubes clamped at given twists (tip minus base). Minima are stable equilibria, and the dot is the arm, without load. Press near another minimum: the arm snaps there."
        : n < 2 ? "One tube has no other to act on." : "These tubes do not act on one another here.";
      if (!shown) return;
      const [one, two] = data.pair;
      const twist = (i) => pose.tipRotations[i] - pose.rotations[i];
      drawMap(canvas, { values: data.map, samples: data.samples }, [twist(one), twist(two)]);
      x.textContent = `twist of tube ${one + 1}, ±220°`;
      y.textContent = `twist of tube ${two + 1}, ±220°`;
    },
  };
}

const DIMENSIONS = [
  ["outer_diameter_mm", "outer ⌀", "mm", 0.2, 5, 0.01, 2],
  ["inner_diameter_mm", "inner ⌀", "mm", 0, 4.9, 0.01, 2],
  ["straight_length_mm", "straight", "mm", 0, 400, 1, 1],
  ["curved_length_mm", "curved", "mm", 0, 300, 1, 1],
  ["curvature_per_m", "curvature", "1/m", -40, 40, 0.1, 2],
];

/** Dimensions of the tubes. */
export function tubesPart(robot, most, actions) {
  const add = make("button", { onclick: actions.addTube, disabled: robot.tubes.length >= most }, "Add a tube");
  const out = part("tubes", "Tubes");
  out.querySelector("h2").append(add);
  const wrong = make("p", { className: "fault", role: "alert" });
  const rows = robot.tubes.map((tube, i) => {
    const remove = make("button", { onclick: () => actions.removeTube(i), "aria-label": `Remove tube ${i + 1}` }, "Remove");
    out.append(heading(i, `Tube ${i + 1}`, ...(robot.tubes.length > 1 ? [remove] : [])));
    return DIMENSIONS.map(([key, name, unit, low, high, step, digits]) => {
      const value = tube[key];
      const row = slider({ name, label: `${name} of tube ${i + 1}`, unit, min: Math.min(low, value), max: Math.max(high, value), step, value, colour: COLOURS[i], changed: (x) => actions.dimension(i, key, x) });
      row.show(value, digits);
      out.append(row.row);
      return row;
    });
  });
  out.append(wrong);
  return {
    out,
    show(faults) {
      wrong.textContent = faults.length ? `Not shown yet: ${faults.join("; ")}.` : "";
      robot.tubes.forEach((tube, i) => DIMENSIONS.forEach(([key, , , , , , digits], k) => rows[i][k].show(tube[key], digits)));
    },
  };
}
