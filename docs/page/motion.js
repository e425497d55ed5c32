// Quasi-static motion of the arm: along its branch of equilibria, and down to the next one where that ends.

import { STATUS } from "./kernel.js";

const CLOSE = { turn: 1e-3, shift: 1e-4 }; // how closely the end of a branch is located, rad and m
const JUMP = 1e-4; // m, by which a tip moves at least where the arm has snapped
const MOST_SNAPS = 8; // of one motion
const TIP = { speed: 0.6, turnRate: 12, shiftRate: 0.6 }; // of a tip that is dragged, m/s, rad/s, m/s

const mix = (a, b, t) => a.map((x, k) => x + t * (b[k] - x));
const between = (from, to, t) => ({
  rotations: mix(from.rotations, to.rotations, t),
  translations: mix(from.translations, to.translations, t),
});
const apart = (a, b) => Math.hypot(...a.map((x, k) => x - b[k]));

function close(from, to, share) {
  const most = (a, b) => share * Math.max(...a.map((x, k) => Math.abs(x - b[k])));
  return most(from.rotations, to.rotations) < CLOSE.turn && most(from.translations, to.translations) < CLOSE.shift;
}

/** The farthest that the branch leads on the straight way to joint values where it does not: fractions before and after. */
export function endOfBranch(kernel, from, to) {
  let [low, high] = [0, 1];
  while (!close(from, to, high - low)) {
    const middle = (low + high) / 2;
    if (kernel.follow(between(from, to, middle)).status === STATUS.done) low = middle;
    else high = middle;
  }
  return [low, high];
}

export class Arm {
  constructor(kernel) {
    this.kernel = kernel;
    this.force = [0, 0, 0];
  }

  get loaded() {
    return this.force.some((f) => f !== 0);
  }

  /** Where it is; and its picture: positions along it, its length, rotations along it. */
  get pose() {
    return this.kernel.pose();
  }

  picture() {
    const shape = this.kernel.shape();
    return { ...shape, turned: this.loaded ? null : this.kernel.along() };
  }

  /** Other tubes, at joint values: from where the arm is, else from tubes without torsion. False where nothing is found. */
  assemble(tubes, joints, fresh) {
    const before = this.force;
    this.kernel.use(tubes);
    if (fresh || !this.kernel.pose() || this.kernel.letGo(joints).status !== STATUS.done) {
      const home = { rotations: joints.rotations.map(() => joints.rotations[0]), translations: joints.translations };
      if (this.kernel.solve(joints).status !== STATUS.done) {
        // From all tubes turned alike, where nothing is wound, as slowly as it takes.
        if (this.kernel.solve(home).status !== STATUS.done) return false;
        this.force = [0, 0, 0];
        this.move(joints);
      }
    }
    this.force = [0, 0, 0];
    if (before.some((f) => f !== 0)) this.push(before);
    return true;
  }

  /** To another equilibrium at the same joint values, let go from tubes twisted evenly up to tip rotations. The snap, or null
   * where the arm comes back to where it was, or bears a load. */
  fall(tipRotations) {
    if (this.loaded) return null;
    const before = this.pose, picture = this.picture(), saved = this.kernel.save(false);
    const fall = this.kernel.letGo(before, tipRotations);
    const jump = fall.pose ? apart(before.position, fall.pose.position) : 0;
    if (fall.pose && apart(fall.pose.tipRotations, before.tipRotations) > CLOSE.turn)
      return { from: before, to: fall.pose, picture, frames: fall.frames, jump, released: before.energy - fall.pose.energy };
    this.kernel.restore(saved);
    return null;
  }

  /** A straight motion of the joints: the snaps on it; `stopped` where the arm stays since it would snap under its load. */
  move(to) {
    const snaps = [];
    for (let round = 0; round < MOST_SNAPS; round++) {
      const { status } = this.kernel.follow(to);
      if (status === STATUS.done) return { snaps };
      const from = this.pose;
      if (status === STATUS.tooFar) {
        const half = this.move(between(from, to, 0.5));
        snaps.push(...half.snaps);
        if (half.stopped) return { snaps, stopped: half.stopped };
        continue;
      }
      if (status !== STATUS.snap) return { snaps, stopped: "these joint values are not possible" };
      const [low, high] = endOfBranch(this.kernel, from, to);
      if (this.loaded) return { snaps, stopped: "the arm would snap under its load: remove the load to continue" };
      const before = this.pose, picture = this.picture();
      // At the very fold the energy is flat: then from a little farther on.
      let fall = this.kernel.letGo(between(from, to, high));
      for (let past = 4 * (high - low); fall.status !== STATUS.done && high + past < 1; past *= 4)
        fall = this.kernel.letGo(between(from, to, high + past));
      if (fall.status !== STATUS.done) return { snaps, stopped: "no stable equilibrium was found beyond this place" };
      const snap = { from: before, to: fall.pose, picture, frames: fall.frames, jump: apart(before.position, fall.pose.position), released: before.energy - fall.pose.energy };
      if (snap.released > 0 && snap.jump > JUMP && !this.#leadsBack(between(from, to, low), before)) snaps.push(snap);
    }
    return { snaps, stopped: "the arm snaps again and again" };
  }

  /** Whether the branch that the arm is on leads to a pose close by: then steps had become too short for the kernel to be sure
   * before the branch ended, and nothing has snapped. */
  #leadsBack(joints, pose) {
    const landed = this.kernel.save(false), back = this.kernel.follow(joints);
    this.kernel.restore(landed);
    return back.status === STATUS.done && apart(back.pose.position, pose.position) < JUMP / 100;
  }

  /** The tip towards a place for so many seconds: how far it is from there, and the reasons for what is left. */
  pull(position, seconds, minMargin) {
    let answer = null;
    const parts = Math.max(1, Math.round(seconds / 0.008));
    for (let k = 0; k < parts; k++) {
      answer = this.kernel.servo({ step: seconds / parts, position, minMargin, ...TIP });
      if (answer.status !== STATUS.done || answer.distance < 1e-6) break;
    }
    return answer;
  }

  /** A force on the tip. False, and the load as it was, where the arm does not bear it. */
  push(force) {
    const none = force.every((f) => f === 0);
    if (none && !this.loaded) return true;
    if (this.kernel.bear(force).status !== STATUS.done) return false;
    this.force = [...force];
    return true;
  }
}
