// A robot as its file has it (mm, deg, GPa), and as the kernel has it (SI).

import { dump, parse } from "./yaml.js";

export const DEG = Math.PI / 180;
export const MM = 1e-3;

const REQUIRED = ["outer_diameter_mm", "inner_diameter_mm", "straight_length_mm", "curved_length_mm"];
const STIFFNESSES = ["bending_stiffness_N_mm2", "torsional_stiffness_N_mm2"];
const TUBE_KEYS = [...REQUIRED, ...STIFFNESSES, "curvature_per_m", "radius_mm", "material", "mass_per_length_g_per_m"];

/** A robot from the text of a file; an Error in one sentence where it cannot be shown. `known`: moduli by material. */
export function readRobot(text, known, most) {
  const data = parse(text);
  if (data.kind === "eccentric") throw new Error("this page shows concentric robots; the file has an eccentric one");
  if (data.kind !== "concentric") throw new Error(`kind is ${data.kind}; a robot file begins with "kind: concentric"`);
  if (!Array.isArray(data.tubes) || !data.tubes.length) throw new Error("tubes is missing; a robot has at least one");
  if (data.tubes.length > most) throw new Error(`the file has ${data.tubes.length} tubes; this page shows up to ${most}`);
  const robot = { ...data, tubes: data.tubes.map((tube, i) => readTube(tube, i, known)) };
  const wrong = faults(robot);
  if (wrong.length) throw new Error(wrong[0]);
  return robot;
}

function readTube(tube, i, known) {
  const of = `tubes[${i}]`;
  if (!tube || typeof tube !== "object") throw new Error(`${of} is no tube`);
  if (tube.pieces) throw new Error(`${of}.pieces: this page shows tubes with one curvature each`);
  for (const key of REQUIRED) if (!(key in tube)) throw new Error(`${of}.${key} is missing`);
  for (const key of Object.keys(tube)) {
    if (!TUBE_KEYS.includes(key)) throw new Error(`${of}.${key} is no key of a tube`);
    if (key !== "material" && !Number.isFinite(tube[key])) throw new Error(`${of}.${key} is ${tube[key]}; it must be a number`);
  }
  if (("radius_mm" in tube) === ("curvature_per_m" in tube))
    throw new Error(`${of} must give either radius_mm or curvature_per_m`);
  const { radius_mm: radius, ...rest } = tube;
  if (radius !== undefined && !(radius > 0)) throw new Error(`${of}.radius_mm is ${radius}; it must be above 0`);
  const own = Object.fromEntries(REQUIRED.map((key) => [key, tube[key]]));
  Object.assign(own, { curvature_per_m: radius === undefined ? rest.curvature_per_m : 1000 / radius }, rest);
  moduli(own, known, of);
  return own;
}

/** Young's and shear modulus of a tube, Pa. */
function moduli(tube, known, of = "tube") {
  const material = tube.material ?? "nitinol";
  if (typeof material === "string") {
    if (!known[material]) throw new Error(`${of}.material is ${material}; known are ${Object.keys(known).join(", ")}`);
    return known[material];
  }
  const { youngs_modulus_GPa: young, shear_modulus_GPa: shear, poisson_ratio: poisson } = material;
  if (!(young > 0)) throw new Error(`${of}.material.youngs_modulus_GPa is ${young}; it must be above 0`);
  if (!(shear > 0) && !(poisson >= 0)) throw new Error(`${of}.material must give shear_modulus_GPa or poisson_ratio`);
  return { youngs: young * 1e9, shear: shear > 0 ? shear * 1e9 : (young * 1e9) / (2 * (1 + poisson)) };
}

/** The robot for `Kernel.use`. */
export function inSI(robot, known) {
  return robot.tubes.map((tube, i) => {
    const outer = tube.outer_diameter_mm / 1000, inner = tube.inner_diameter_mm / 1000;
    const area = (Math.PI / 64) * (outer ** 4 - inner ** 4);
    const { youngs, shear } = moduli(tube, known);
    const straight = tube.straight_length_mm / 1000, curved = tube.curved_length_mm / 1000;
    const turn = robot.limits?.rotations_deg?.[i] ?? [-360, 360];
    const shift = robot.limits?.translations_mm?.[i] ?? [-Infinity, Infinity];
    return {
      kb: (tube.bending_stiffness_N_mm2 ?? youngs * area * 1e6) / 1e6,
      kt: (tube.torsional_stiffness_N_mm2 ?? shear * 2 * area * 1e6) / 1e6,
      curvature: tube.curvature_per_m,
      straight,
      curved,
      mass: 0, // the page has no gravity
      turnRange: turn.map((t) => t * DEG),
      shiftRange: [Math.max(shift[0] / 1000, -curved), Math.min(shift[1] / 1000, straight)],
    };
  });
}

/** In words, why tubes make no robot; empty where they do. */
export function faults({ tubes }) {
  const found = [];
  tubes.forEach((tube, i) => {
    const length = tube.straight_length_mm + tube.curved_length_mm;
    const next = tubes[i + 1];
    if (!(tube.outer_diameter_mm > tube.inner_diameter_mm && tube.inner_diameter_mm >= 0))
      found.push(`tube ${i + 1}: the inner diameter must be from 0 to less than the outer one`);
    if (!(length > 0 && tube.straight_length_mm >= 0 && tube.curved_length_mm >= 0))
      found.push(`tube ${i + 1} must have a length`);
    if (next && tube.outer_diameter_mm > next.inner_diameter_mm)
      found.push(`tube ${i + 1} (${tube.outer_diameter_mm} mm) does not fit into tube ${i + 2} (inside ${next.inner_diameter_mm} mm)`);
    if (next && length < next.straight_length_mm + next.curved_length_mm - 1e-9)
      found.push(`tube ${i + 1} must not be shorter than tube ${i + 2} around it`);
  });
  return found;
}

/** Least and greatest translation of tube i with the other tubes where they are: ranges and order; SI. */
export function shiftRange(tubes, translations, i) {
  let [low, high] = tubes[i].shiftRange;
  const behind = (a, b) => tubes[a].straight - tubes[b].straight, beyond = (a, b) => tubes[a].curved - tubes[b].curved;
  if (i + 1 < tubes.length) {
    high = Math.min(high, translations[i + 1] + behind(i, i + 1));
    low = Math.max(low, translations[i + 1] + beyond(i + 1, i));
  }
  if (i > 0) {
    low = Math.max(low, translations[i - 1] + behind(i, i - 1));
    high = Math.min(high, translations[i - 1] + beyond(i - 1, i));
  }
  return [low, Math.max(low, high)];
}

const clamp = (x, [low, high]) => Math.min(Math.max(x, low), high);

/** The joint values nearest to given ones that ranges and order allow, from the outermost tube inwards. */
export function allowed(tubes, { rotations, translations }) {
  const shift = Array(tubes.length).fill(0);
  for (let i = tubes.length - 1; i >= 0; i--) {
    const range = shiftRange(tubes.slice(i), [0, ...shift.slice(i + 1)], 0);
    shift[i] = clamp(translations[i] ?? 0, range);
  }
  return { rotations: tubes.map((tube, i) => clamp(rotations[i] ?? 0, tube.turnRange)), translations: shift };
}

/** The text of a robot file. */
export function writeRobot(robot) {
  const { kind, name, tubes, ...rest } = robot;
  return `# Made with the page of tubeopt. Tubes from the inner one outwards.\n${dump({ kind, name, tubes, ...rest })}`;
}

/** Robot, pose and force as a part of an address, and back. The tip rotations tell the branch. */
export function toHash(robot, { rotations, translations, tipRotations }, force) {
  const inUnit = (list, one, digits = 12) => list.map((x) => Number((x / one).toPrecision(digits)));
  const all = { robot, turn: inUnit(rotations, DEG), shift: inUnit(translations, MM), tips: inUnit(tipRotations, DEG, 6), force };
  const bytes = new TextEncoder().encode(JSON.stringify(all));
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}

export function fromHash(hash, known, most) {
  const bytes = Uint8Array.from(atob(hash.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0));
  const { robot, turn, shift, tips, force } = JSON.parse(new TextDecoder().decode(bytes));
  const numbers = (list, count) => {
    if (!Array.isArray(list) || list.length !== count || !list.every(Number.isFinite)) throw new Error("the address is not complete");
    return list;
  };
  const read = readRobot(dump(robot), known, most);
  const n = read.tubes.length;
  const joints = { rotations: numbers(turn, n).map((a) => a * DEG), translations: numbers(shift, n).map((d) => d * MM) };
  return { robot: read, joints, tipRotations: numbers(tips, n).map((a) => a * DEG), force: numbers(force, 3) };
}
