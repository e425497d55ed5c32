// The page: what the user does goes to the arm, and what the arm is goes to the picture and the controls, once a frame.

import { Kernel, STATUS, WHY } from "./kernel.js";
import { Arm } from "./motion.js";
import { WINDOW } from "./map.js";
import { jointsPart, make, stabilityPart, tipPart, tubesPart } from "./panels.js";
import { allowed, DEG, faults, fromHash, inSI, MM, readRobot, shiftRange, toHash, writeRobot } from "./robot.js";
import { Scene } from "./scene.js";

const SNAP_TIME = matchMedia("(prefers-reduced-motion: reduce)").matches ? 1 : 700; // ms, of the animation
const GHOST_TIME = 5000; // ms, for which the arm before a snap is seen
const GRAB = 34; // px around the tip
const FORCE_PER_METRE = 0.4; // N, of a force that is dragged; its arrow is as long
const CLOSE_TO_SNAP = 0.25; // margins below are called close, as in the viewer

const OWN = "own", CHANGED = ", changed"; // in the list of robots; at the end of a name
const FIRST = { rotations: [0, 57.3 * DEG, 114.6 * DEG], translations: [0, 0, 0] }; // as in the first command of the README

const number = (x, digits) => x.toFixed(digits).replace("-", "−");
const by = (id) => document.getElementById(id);
const dark = matchMedia("(prefers-color-scheme: dark)");
const theme = () => (dark.matches
  ? { grid: "#8d98a8", plate: "#5c6673", ghost: "#9aa4b2", handle: "#ffffff", knob: "#2a3038" }
  : { grid: "#7c8794", plate: "#aab2bd", ghost: "#8a93a0", handle: "#20242b", knob: "#ffffff" });

const page = {
  robot: null, tubes: [], arm: null, scene: null, parts: null,
  wanted: null, wantedForce: null, drag: null, mode: "move", floor: 0.05,
  picture: null, pose: null, fall: null, ghost: null, ahead: null, unloadedTip: null,
  changed: true, frames: 0,
};

// --- the robot ---------------------------------------------------------------------------------------------------------

const home = (tubes) => allowed(tubes, { rotations: tubes.map(() => 0), translations: tubes.map(() => 0) });

/** Every tube in the middle of what those around it leave. */
function spread(tubes) {
  const translations = tubes.map(() => 0);
  for (let i = tubes.length - 1; i >= 0; i--) {
    const [low, high] = shiftRange(tubes.slice(i), [0, ...translations.slice(i + 1)], 0);
    translations[i] = (low + high) / 2;
  }
  return { rotations: tubes.map(() => 0), translations };
}

/** Shows a robot at joint values; `fresh` where it is another robot than before. */
function show(robot, joints, { fresh = true, force = [0, 0, 0], tipRotations = null } = {}) {
  const tubes = inSI(robot, page.known), at = allowed(tubes, joints ?? spread(tubes));
  if (!page.arm.assemble(tubes, at, fresh || tubes.length !== page.tubes.length)) {
    say("No stable equilibrium was found for these tubes.", "bad");
    if (page.robot) page.arm.assemble(page.tubes, page.pose, true);
    return false;
  }
  const others = tubes.length !== page.tubes.length || fresh;
  Object.assign(page, { robot, tubes, ahead: null, wanted: null, fall: null, ghost: null });
  if (others) build();
  if (tipRotations) page.arm.fall(tipRotations); // where the branch is another one than that of a cold solve
  if (force.some((f) => f)) push(force);
  page.certificateAt = null;
  if (fresh) page.scene.frame(Math.max(...ends(at.translations), 0));
  change();
  return true;
}

const ends = (translations) => page.tubes.map((tube, i) => translations[i] + tube.curved);
const radii = () => page.robot.tubes.map((tube) => (tube.outer_diameter_mm * MM) / 2);

function build() {
  const { robot, tubes } = page;
  page.parts = {
    joints: jointsPart(tubes, { joint: moveJoint, home: () => move(home(page.tubes)) }),
    stability: stabilityPart(tubes.length, { pair: (pair) => change(page.parts.stability.choose(pair)), fall }),
    tip: tipPart({ mode: setMode, floor: (x) => (page.floor = Math.min(Math.max(x, 0), 0.99)), force: setForce }, page.mode, page.floor),
    tubes: tubesPart(robot, page.arm.kernel.most, { dimension, addTube, removeTube }),
  };
  const shown = by("panel").querySelector(".shown")?.dataset.part ?? "joints";
  by("panel").replaceChildren(...Object.values(page.parts).map((one) => one.out));
  openTab(shown);
}

function dimension(i, key, value) {
  const tubes = page.robot.tubes.map((tube, k) => (k === i ? { ...tube, [key]: value } : tube));
  changedRobot();
  // The panel shows what was asked for also where it makes no robot.
  page.robot.tubes.forEach((tube, k) => Object.assign(tube, tubes[k]));
  const wrong = faults(page.robot);
  page.parts.tubes.show(wrong);
  if (!wrong.length) show(page.robot, page.pose, { fresh: false });
}

/** The robot is no longer the one of the list or the file. */
function changedRobot() {
  by("robots").value = OWN;
  if (!page.robot.name?.endsWith(CHANGED)) page.robot.name = `${page.robot.name ?? "robot"}${CHANGED}`;
}

function addTube() {
  changedRobot();
  const around = page.robot.tubes.at(-1), round = (x, digits = 2) => Number(x.toFixed(digits));
  const tube = {
    ...around,
    inner_diameter_mm: round(around.outer_diameter_mm + 0.05),
    outer_diameter_mm: round(around.outer_diameter_mm + 0.25),
    straight_length_mm: round(0.6 * around.straight_length_mm, 0),
    curved_length_mm: round(0.6 * around.curved_length_mm, 0),
    curvature_per_m: round(0.6 * around.curvature_per_m),
  };
  const robot = { ...page.robot, tubes: [...page.robot.tubes, tube] };
  delete robot.limits;
  show(robot, withTube(page.pose, page.robot.tubes.length));
}

const withTube = ({ rotations, translations }, i) => ({ rotations: rotations.toSpliced(i, 0, 0), translations: translations.toSpliced(i, 0, 0) });

function removeTube(i) {
  changedRobot();
  const robot = { ...page.robot, tubes: page.robot.tubes.toSpliced(i, 1) };
  delete robot.limits;
  show(robot, { rotations: page.pose.rotations.toSpliced(i, 1), translations: page.pose.translations.toSpliced(i, 1) });
}

// --- motion ------------------------------------------------------------------------------------------------------------

function move(joints) {
  page.wanted = joints;
  change();
}

function moveJoint(kind, i, value) {
  const now = page.wanted ?? page.pose;
  const range = kind === "rotations" ? page.tubes[i].turnRange : shiftRange(page.tubes, now.translations, i);
  move({ rotations: now.rotations, translations: now.translations, [kind]: now[kind].with(i, Math.min(Math.max(value, range[0]), range[1])) });
}

function setMode(mode) {
  page.mode = mode;
  page.parts.tip.mode(mode);
  by("hint").textContent = mode === "move" ? "Drag the ball: the tip follows. Drag beside it: the view turns." : "Drag from the ball: a force pulls the tip that way. Drag beside it: the view turns.";
  change();
}

/** One component of the force, or none at all. */
function setForce(axis, value) {
  page.wantedForce = axis === null ? [0, 0, 0] : (page.wantedForce ?? page.arm.force).with(axis, value);
  change();
}

function push(force) {
  if (!page.arm.loaded) page.unloadedTip = page.arm.pose.position;
  if (page.arm.push(force)) return;
  say(`The arm snaps or buckles before it carries ${(Math.hypot(...force) / MM).toFixed(1)} mN: the force stays as it was.`, "bad");
}

const JOINTS = { rotations: ["rotation", DEG, "°", 1], translations: ["translation", MM, " mm", 2] };

/** Which joint has moved most, and where it was last before a snap. */
function named(from, to, snap) {
  let best = { size: 0, words: "" };
  for (const [kind, [word, unit, sign, digits]] of Object.entries(JOINTS))
    to[kind].forEach((value, i) => {
      const size = Math.abs(value - from[kind][i]) / (kind === "rotations" ? 1 : 0.05);
      if (size > best.size) best = { size, words: `${word} ${number(snap.from[kind][i] / unit, digits)}${sign} of tube ${i + 1}` };
    });
  return best.words;
}

/** The arm let go with the tips of two tubes twisted by as much. */
function fall(pair, twists) {
  const tips = [...page.pose.tipRotations];
  pair.forEach((i, k) => (tips[i] = page.pose.rotations[i] + twists[k]));
  const snap = page.arm.fall(tips);
  if (snap) animate(snap, `Another equilibrium: the tip jumped ${(snap.jump / MM).toFixed(1)} mm, the energy is ${Math.abs(snap.released / MM).toFixed(3)} mJ ${snap.released > 0 ? "lower" : "higher"}.`);
  else say(page.arm.loaded ? "Remove the load first: the map is of the arm without load." : "From there the arm returns to this equilibrium.");
  change();
}

function animate(snap, words) {
  say(words, "snap");
  page.fall = { ...snap, begun: performance.now(), length: snap.picture.length };
  page.ghost = { picture: snap.picture, until: performance.now() + SNAP_TIME + GHOST_TIME };
}

function step(seconds) {
  if (page.wanted) {
    const from = page.pose, to = page.wanted;
    page.wanted = null;
    const { snaps, stopped } = page.arm.move(to);
    if (stopped) say(`Stopped: ${stopped}.`, "bad");
    for (const snap of snaps)
      animate(snap, `Snap at ${named(from, to, snap)}: the tip jumped ${(snap.jump / MM).toFixed(1)} mm, ${(snap.released / MM).toFixed(3)} mJ released.`);
  }
  if (page.wantedForce) {
    push(page.wantedForce);
    page.wantedForce = null;
  }
  if (page.drag?.kind === "move") {
    const answer = page.arm.pull(page.drag.target, seconds, page.floor);
    page.drag.stuck = Math.abs(page.drag.short - (answer?.distance ?? 0)) < 1e-5;
    page.drag.short = answer?.distance ?? 0;
    page.drag.why = answer?.why ?? 0;
    if (answer?.status !== STATUS.done) say("The tip cannot be moved from here: move a joint first.", "bad");
  }
}

const REASONS = [
  [WHY.margin, "the margin is at its least value"],
  [WHY.order, "tubes or carriages touch"],
  [WHY.range, "a joint is at the end of its range"],
  [WHY.held, "no step is safe"],
];

function explain({ short, why, stuck }) {
  if (short < 5e-4) return say("");
  const known = REASONS.filter(([bit]) => why & bit).map(([, words]) => words).join(", ");
  const reason = known || (why & WHY.noCloser || stuck ? "it comes no closer" : "");
  if (reason) say(`The tip stops ${(short / MM).toFixed(1)} mm short: ${reason}.`);
}

// --- what lies ahead, by a worker --------------------------------------------------------------------------------------

const AHEAD_PAUSE = 100; // ms between two questions: the worker must not take the processor from the picture
const ahead = { worker: null, busy: false, stale: false };

function lookAhead() {
  ahead.stale = true;
  if (ahead.busy || !ahead.worker) return;
  ahead.busy = true;
  ahead.stale = false;
  const { tubes, pose } = page, { rotations, translations } = pose, pair = page.parts.stability.pair();
  const saved = page.arm.kernel.save(page.arm.loaded);
  const ranges = { rotations: tubes.map((tube) => tube.turnRange), translations: tubes.map((_, i) => shiftRange(tubes, translations, i)) };
  const window = pair?.map((i) => [rotations[i] - WINDOW, rotations[i] + WINDOW]);
  ahead.of = page.robot;
  ahead.worker.postMessage({ tubes, saved, joints: { rotations, translations }, ranges, pair, window }, [saved.buffer]);
}

function aheadFound({ data }) {
  setTimeout(() => {
    ahead.busy = false;
    if (ahead.stale) lookAhead();
  }, AHEAD_PAUSE);
  if (ahead.of === page.robot && data.joints.rotations.length === page.tubes.length) {
    page.ahead = data;
    page.mapChanged = true;
    change(false);
  }
}

function nearestSnap() {
  if (!page.ahead) return "…";
  const found = [];
  for (const [kind, [, unit, sign, digits]] of Object.entries(JOINTS))
    page.ahead.snaps[kind].forEach((sides, i) =>
      sides.forEach((at) => {
        if (at === null) return;
        const by = at - page.pose[kind][i];
        found.push({ share: Math.abs(by) / (kind === "rotations" ? 1 : 0.05), kind, words: `tube ${i + 1} by ${by > 0 ? "+" : ""}${number(by / unit, digits)}${sign}` });
      }));
  const turn = found.filter((one) => one.kind === "rotations").sort((a, b) => a.share - b.share)[0];
  const shift = found.filter((one) => one.kind === "translations").sort((a, b) => a.share - b.share)[0];
  return [turn, shift].filter(Boolean).map((one) => one.words).join("; ") || "none by one joint alone";
}

// --- what is shown -----------------------------------------------------------------------------------------------------

let message = 0;

function say(words, kind = "") {
  const box = by("message");
  clearTimeout(message);
  box.textContent = words;
  box.className = kind;
  box.hidden = !words;
  if (words) message = setTimeout(() => (box.hidden = true), 7000);
}

function change(moved = true) {
  if (moved) page.changed = true;
  if (!page.frames) page.frames = requestAnimationFrame(frame);
}

let last = 0;

function frame(now) {
  page.frames = 0;
  const seconds = Math.min(Math.max((now - last) / 1000, 0.004), 0.05);
  last = now;
  step(seconds);
  if (page.changed || page.drag?.kind === "move") {
    page.changed = false;
    refresh();
  }
  if (page.mapChanged) {
    page.mapChanged = false;
    page.parts.stability.map(page.ahead, page.pose);
    showAhead();
  }
  paint(now);
  if (page.drag?.kind === "move" || page.fall || page.ghost) change(false);
}

/** Controls and readout to what the arm is. */
function refresh() {
  const { arm, parts } = page;
  page.pose = arm.pose;
  page.picture = arm.picture();
  const { margin, position } = page.pose;
  by("margin").textContent = number(margin, 3);
  const state = margin < 0.05 ? "edge" : margin < CLOSE_TO_SNAP ? "close" : "stable";
  by("margin").dataset.state = state;
  by("state").textContent = state === "stable" ? "stable" : "close to a snap";
  by("bar").style.width = `${Math.min(Math.max(margin, 0), 1) * 100}%`;
  by("bar").style.background = `var(--${{ stable: "good", close: "fair", edge: "bad" }[state]})`;
  by("tip").textContent = `${position.map((x) => number(x / MM, 1)).join(", ")} mm`;
  parts.tip.show(arm.force, arm.loaded ? Math.hypot(...position.map((x, k) => x - page.unloadedTip[k])) : 0);
  const key = page.pose.translations.join();
  if (page.certificateAt !== key) {
    page.certificateAt = key;
    page.certificate = arm.kernel.certificate(page.pose.translations);
    parts.stability.certificate(page.certificate);
    parts.tubes.show(faults(page.robot));
  }
  showAhead();
  if (page.drag?.kind === "move") explain(page.drag);
  lookAhead();
  remember();
}

function showAhead() {
  page.parts.joints.show(page.wanted ?? page.pose, page.ahead?.snaps);
  by("next").textContent = nearestSnap();
}

function paint(now) {
  const { scene, pose, arm } = page, tubeEnds = ends(pose.translations), size = radii();
  let picture = page.picture;
  if (page.fall) {
    const t = (now - page.fall.begun) / SNAP_TIME, { frames } = page.fall;
    // It begins slowly, as from a fold.
    const at = Math.min(Math.floor(t ** 2 * frames.length), frames.length - 1);
    if (t >= 1) page.fall = null;
    else picture = { points: frames[Math.max(at, 0)], length: page.fall.length, turned: null };
  }
  scene.setArm(picture, tubeEnds, size);
  const left = page.ghost ? page.ghost.until - now : 0;
  if (left <= 0) page.ghost = null;
  scene.setGhost(page.ghost?.picture ?? null, size, 0.4 * Math.min(left / 1000, 1));
  const tip = Array.from(picture.points.slice(-3));
  scene.setHandles({
    tip,
    target: page.drag?.kind === "move" && page.drag.short > 5e-4 ? page.drag.target : null,
    force: arm.loaded ? arm.force.map((f) => f / FORCE_PER_METRE) : null,
    active: Boolean(page.drag?.kind),
  });
  page.tip = tip;
  scene.draw();
  if (!page.drawn) performance.mark("picture");
  page.drawn = true;
}

// --- pointer -----------------------------------------------------------------------------------------------------------

const pointers = new Map();

function listen(canvas) {
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const near = (place) => Math.hypot(...page.scene.project(page.tip).slice(0, 2).map((x, k) => x - place[k])) < GRAB;
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    if (pointers.size === 1 && near(at(event))) page.drag = { kind: page.mode, target: page.tip, from: page.tip, force: page.arm.force, short: 0, why: 0 };
    if (pointers.size === 2) page.drag = null;
    canvas.classList.add("drag");
    change(false);
  };
  canvas.onpointermove = (event) => {
    const place = at(event), before = pointers.get(event.pointerId);
    if (!before) return void canvas.classList.toggle("near", near(place));
    const [dx, dy] = place.map((x, k) => x - before[k]);
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1], gap = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]);
      page.scene.zoom(gap(before) / Math.max(gap(place), 1));
      page.scene.orbit(dx / 2, dy / 2);
    } else if (page.drag) {
      page.drag.target = page.scene.moved(page.drag.target, dx, dy);
      if (page.drag.kind === "push") page.wantedForce = page.drag.target.map((x, k) => page.drag.force[k] + FORCE_PER_METRE * (x - page.drag.from[k]));
    } else page.scene.orbit(dx, dy);
    pointers.set(event.pointerId, place);
    change(Boolean(page.drag));
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => {
    pointers.delete(event.pointerId);
    page.drag = null;
    canvas.classList.remove("drag");
    change(false);
  };
  canvas.onwheel = (event) => {
    event.preventDefault();
    page.scene.zoom(Math.exp(0.0012 * event.deltaY));
    change(false);
  };
  canvas.ondblclick = () => {
    page.scene.frame(page.picture.length);
    change(false);
  };
}

// --- files, address, tabs ----------------------------------------------------------------------------------------------

let remembering = 0;

/** The address of what is shown: it can be shared, and a reload shows the same. */
function remember() {
  clearTimeout(remembering);
  remembering = setTimeout(() => history.replaceState(null, "", `#${toHash(page.robot, page.pose, page.arm.force)}`), 400);
}

async function read(text, name) {
  try {
    if (!show(readRobot(text, page.known, page.arm.kernel.most))) return;
    by("robots").value = OWN;
    say(`${page.robot.name ?? name}: ${page.robot.tubes.length} tubes.`);
    const unused = ["friction", "calibration", "clearance_mm"].filter((key) => key in page.robot);
    if (unused.length) say(`${name}: ${unused.join(", ")} of the file do not act in this page.`);
  } catch (error) {
    say(`${name}: ${error.message}.`, "bad");
  }
}

function files() {
  by("open").onclick = () => by("file").click();
  by("file").onchange = async ({ target }) => {
    const [file] = target.files;
    if (file) await read(await file.text(), file.name);
    target.value = "";
  };
  document.body.ondragover = (event) => event.preventDefault();
  document.body.ondrop = async (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (file) await read(await file.text(), file.name);
  };
  by("save").onclick = () => {
    const url = URL.createObjectURL(new Blob([writeRobot(page.robot)], { type: "application/yaml" }));
    make("a", { href: url, download: "robot.yaml" }).click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
  };
  by("share").onclick = async () => {
    const address = `${location.href.split("#")[0]}#${toHash(page.robot, page.pose, page.arm.force)}`;
    history.replaceState(null, "", address);
    try {
      await navigator.clipboard.writeText(address);
      say("The address of this robot, its joint values and its load is copied.");
    } catch {
      say("The address bar has this robot, its joint values and its load: copy it from there.");
    }
  };
}

const TABS = { joints: "Joints", stability: "Stability", tip: "Tip", tubes: "Tubes" };

function openTab(name) {
  for (const one of by("panel").children) one.classList.toggle("shown", one.dataset.part === name);
  for (const one of by("tabs").children) one.setAttribute("aria-selected", one.dataset.part === name);
}

function tabs() {
  by("tabs").setAttribute("role", "tablist");
  for (const [name, words] of Object.entries(TABS))
    by("tabs").append(make("button", { onclick: () => openTab(name), role: "tab", "data-part": name }, words));
}

async function shipped() {
  const response = await fetch(new URL("robots.json", import.meta.url));
  if (!response.ok) throw new Error("The robots are missing: this site was built without robots.json.");
  return response.json();
}

async function begin() {
  tabs();
  const [kernel, { robots, materials }] = await Promise.all([Kernel.fetch(), shipped()]);
  page.known = materials;
  page.arm = new Arm(kernel);
  page.scene = new Scene(by("scene"), by("floor"), theme());
  ahead.worker = new Worker(new URL("ahead.js", import.meta.url), { type: "module" });
  ahead.worker.onmessage = aheadFound;
  dark.onchange = () => {
    page.scene.theme = theme();
    change();
  };
  const select = by("robots");
  select.append(make("option", { value: OWN, hidden: true }, "your own robot"), ...robots.map(({ name }, k) => make("option", { value: k }, name)));
  const choose = (k) => show(readRobot(robots[k].text, materials, kernel.most));
  select.onchange = () => choose(select.value);
  select.value = 0;
  let shown = false;
  if (location.hash.length > 1)
    try {
      const { robot, joints, tipRotations, force } = fromHash(location.hash.slice(1), materials, kernel.most);
      shown = show(robot, joints, { force, tipRotations });
      const known = robots.findIndex((one) => one.name === robot.name);
      select.value = known < 0 ? OWN : known;
    } catch {
      say("The address does not describe a robot: this is the first one of the list.", "bad");
    }
  if (!shown) show(readRobot(robots[0].text, materials, kernel.most), FIRST);
  listen(by("scene"));
  files();
  new ResizeObserver(() => change(false)).observe(by("scene"));
  if (innerWidth < 860) say(by("hint").textContent);
  document.documentElement.dataset.ready = "true";
}

begin().catch((error) => {
  say(error.message, "bad");
  clearTimeout(message); // it stays: there is nothing else to see
});
window.tubeoptPage = page; // for tests and the console
