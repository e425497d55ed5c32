// A worker with a kernel of its own: what lies ahead of the arm. Snaps along every joint, and the energy map.

import { Kernel, STATUS } from "./kernel.js";
import { endOfBranch } from "./motion.js";

const STEP = { rotations: 0.15, translations: 0.005 }; // rad, m
const SAMPLES = 41;

const ready = Kernel.fetch();

/** Where the branch ends if one joint alone moves from `low` to `end`; null where it does not end. */
function nextSnap(kernel, saved, joints, kind, tube, end) {
  kernel.restore(saved);
  const at = (value) => ({ ...joints, [kind]: joints[kind].with(tube, value) });
  let here = joints[kind][tube];
  const side = Math.sign(end - here);
  while (side * (end - here) > 1e-9) {
    const next = here + side * Math.min(STEP[kind], Math.abs(end - here));
    if (kernel.follow(at(next)).status === STATUS.done) {
      here = next;
      continue;
    }
    const [low, high] = endOfBranch(kernel, at(here), at(next));
    return here + ((low + high) / 2) * (next - here);
  }
  return null;
}

self.onmessage = async ({ data }) => {
  const kernel = await ready;
  const { tubes, saved, joints, ranges, pair, window } = data;
  const started = performance.now();
  kernel.use(tubes);
  kernel.restore(saved);
  const snaps = {};
  for (const kind of ["rotations", "translations"])
    snaps[kind] = tubes.map((_, i) => ranges[kind][i].map((end) => nextSnap(kernel, saved, joints, kind, i, end)));
  const map = pair && kernel.energyMap(joints, pair, window, SAMPLES);
  self.postMessage({ snaps, map, samples: SAMPLES, pair, joints, milliseconds: performance.now() - started });
};
