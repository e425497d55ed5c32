// The solver: the C kernel of tubeopt, compiled to WebAssembly. Numbers are SI; tubes go from the inner one outwards.

export const STATUS = { done: 0, declined: 1, badInput: 2, notStarted: 3, snap: 4, tooFar: 5, tooLarge: 6 };
export const WHY = { rate: 1, range: 2, order: 4, margin: 8, shortened: 16, held: 32, noCloser: 128 };

const POINTS = 65;

/** One arm in the memory of one instance of the kernel. */
export class Kernel {
  constructor(exports, tubes) {
    this.c = exports;
    this.most = exports.most_tubes();
    this.n = tubes;
  }

  /** From the bytes of kernel.wasm. */
  static async load(bytes) {
    const { instance } = await WebAssembly.instantiate(bytes, {});
    instance.exports._initialize?.();
    return new Kernel(instance.exports, 0);
  }

  /** From kernel.wasm beside this file. */
  static async fetch() {
    const response = await fetch(new URL("kernel.wasm", import.meta.url));
    if (!response.ok) throw new Error("The solver is missing: this site was built without kernel.wasm.");
    return Kernel.load(await response.arrayBuffer());
  }

  #put(numbers, at = 0) {
    new Float64Array(this.c.memory.buffer, this.c.input() + 8 * at, numbers.length).set(numbers);
  }

  #out(count, at = 0) {
    return new Float64Array(this.c.memory.buffer, this.c.output() + 8 * at, count);
  }

  // Joint values of all tubes that the kernel has room for.
  #putJoints({ rotations, translations }) {
    const all = new Float64Array(2 * this.most);
    all.set(rotations);
    all.set(translations, this.most);
    this.#put(all);
  }

  #pose() {
    const { most, n } = this;
    const all = Array.from(this.#out(3 * most + 16));
    const own = (at) => all.slice(at, at + n);
    const rest = 3 * most + 12;
    return {
      rotations: own(0),
      translations: own(most),
      position: all.slice(2 * most, 2 * most + 3),
      frame: all.slice(2 * most + 3, 2 * most + 12),
      tipRotations: own(2 * most + 12),
      margin: all[rest],
      energy: all[rest + 1],
      error: all[rest + 2],
      residual: all[rest + 3],
    };
  }

  /** Sets the robot. Each tube: bending and torsional stiffness, curvature, lengths, mass per length, ranges. */
  use(tubes) {
    const rows = tubes.flatMap((t) => [
      t.kb, t.kt, t.curvature, t.straight, t.curved, t.mass, ...t.turnRange, ...t.shiftRange,
    ]);
    this.#put(rows);
    const status = this.c.use(tubes.length);
    if (status === STATUS.tooLarge) throw new Error("The browser has too little memory for the solver.");
    if (status !== STATUS.done) throw new Error(`a robot of ${tubes.length} tubes; at most ${this.most}`);
    this.n = tubes.length;
  }

  /** The stable equilibrium from tubes without torsion, without load: {status, pose}. */
  solve(joints) {
    this.#putJoints(joints);
    return this.#answer(this.c.solve_cold());
  }

  /** The equilibrium after a straight slow motion; status `snap` where the branch ends first. */
  follow(joints) {
    this.#putJoints(joints);
    return this.#answer(this.c.follow());
  }

  /** The arm let go at joint values: the minimum that it falls into, and frames (positions) on the way. It begins with the
   * torsion that it has, or with tubes twisted evenly up to `tipRotations`. */
  letGo(joints, tipRotations = null) {
    this.#putJoints(joints);
    if (tipRotations) this.#put([...tipRotations, ...Array(this.most - this.n).fill(0)], 2 * this.most);
    const count = this.c.let_go(tipRotations ? 1 : 0);
    const all = this.#out(count * POINTS * 3).slice();
    const frames = Array.from({ length: count }, (_, k) => all.subarray(3 * POINTS * k, 3 * POINTS * (k + 1)));
    return { status: count ? STATUS.done : STATUS.declined, frames, pose: count ? this.pose() : null };
  }

  /** The arm under a force on the tip and gravity. */
  bear(force, gravity = [0, 0, 0]) {
    this.#put([...force, ...gravity]);
    return this.#answer(this.c.bear());
  }

  /** One step of the tip towards a position within rates, ranges, order and the floor of the margin. */
  servo({ step, position, direction = [0, 0, 0], speed, turnRate, shiftRate, minMargin, push = 0 }) {
    this.#put([step, ...position, ...direction, speed, turnRate, shiftRate, minMargin, push]);
    const answer = this.#answer(this.c.servo());
    const [distance, angle, why] = this.#out(3, 3 * this.most + 16);
    return { ...answer, distance, angle, why };
  }

  #answer(status) {
    return { status, pose: status === STATUS.done ? this.#pose() : null };
  }

  /** The last equilibrium. */
  pose() {
    return this.#answer(this.c.pose()).pose;
  }

  /** Positions along the last equilibrium, and its length. */
  shape() {
    this.c.shape();
    return { points: this.#out(3 * POINTS).slice(), length: this.#out(1, 3 * POINTS)[0] };
  }

  /** Rotations (points, tubes) along the last equilibrium. */
  along() {
    this.c.along();
    const all = this.#out(POINTS * this.most);
    return Array.from({ length: POINTS }, (_, k) => Array.from(all.subarray(k * this.most, k * this.most + this.n)));
  }

  /** mu_cert at translations: above 0 no rotations can make the robot snap. */
  certificate(translations) {
    this.#putJoints({ rotations: translations.map(() => 0), translations });
    return this.c.certificate();
  }

  /** Least energy with two tips held, (samples, samples) by the first; null where the two do not act on one another. */
  energyMap(joints, [one, two], window, samples) {
    this.#putJoints(joints);
    this.#put(window.flat(), 2 * this.most);
    return this.c.energy_map(one, two, samples) ? this.#out(samples * samples).slice() : null;
  }

  /** All that the last equilibrium is, to be returned to, also in another instance with the same robot. */
  save(loaded) {
    const size = loaded ? this.c.room_size() : this.c.own_size();
    return new Uint8Array(this.c.memory.buffer, this.c.room(), size).slice();
  }

  restore(saved) {
    new Uint8Array(this.c.memory.buffer, this.c.room(), saved.length).set(saved);
  }
}
