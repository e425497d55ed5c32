// The energy over the twists of two tubes, as a picture with contour lines and the state of the arm in it.

export const WINDOW = (220 * Math.PI) / 180; // rad, to either side of no twist

// Dark where the energy is small; perceived lightness grows evenly.
const STOPS = [[35, 32, 74], [52, 82, 130], [48, 134, 142], [98, 182, 122], [205, 214, 90], [250, 240, 190]];

function colour(t) {
  const x = Math.min(Math.max(t, 0), 1) * (STOPS.length - 1), k = Math.min(Math.floor(x), STOPS.length - 2);
  return STOPS[k].map((c, j) => c + (x - k) * (STOPS[k + 1][j] - c));
}

/** Draws a map {values, samples}: the first tube to the right, the second upwards; `state`: the twists of both, rad. */
export function drawMap(canvas, { values, samples }, state) {
  const context = canvas.getContext("2d"), size = canvas.width;
  const known = values.filter(Number.isFinite), low = Math.min(...known), high = Math.max(...known);
  const level = (v) => Math.sqrt((v - low) / (high - low || 1));
  const small = new OffscreenCanvas(samples, samples), image = new ImageData(samples, samples);
  const at = (i, j) => values[i * samples + j];
  for (let i = 0; i < samples; i++)
    for (let j = 0; j < samples; j++) {
      const here = 4 * ((samples - 1 - j) * samples + i);
      image.data.set([...(Number.isFinite(at(i, j)) ? colour(level(at(i, j))) : [128, 128, 128]), 255], here);
    }
  small.getContext("2d").putImageData(image, 0, 0);
  context.imageSmoothingEnabled = true;
  context.imageSmoothingQuality = "high";
  // The centres of the outer pixels are the ends of the window.
  const edge = size / (samples - 1) / 2;
  context.drawImage(small, -edge, -edge, size + 2 * edge, size + 2 * edge);
  const place = (k) => (size * k) / (samples - 1);
  context.strokeStyle = "rgba(255, 255, 255, 0.35)";
  context.lineWidth = size / 400;
  context.beginPath();
  for (let c = 1; c < 14; c++) contour(context, at, samples, low + (high - low) * (c / 14) ** 2, place, size);
  context.stroke();
  if (!state) return;
  const [x, y] = state.map((a) => (size * (a + WINDOW)) / (2 * WINDOW));
  context.beginPath();
  context.arc(x, size - y, size / 45, 0, 7);
  context.fillStyle = "#fff";
  context.fill();
  context.lineWidth = size / 130;
  context.strokeStyle = "#111";
  context.stroke();
}

/** Marching squares. */
function contour(context, at, samples, value, place, size) {
  for (let i = 0; i + 1 < samples; i++)
    for (let j = 0; j + 1 < samples; j++) {
      const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]], cuts = [];
      for (let k = 0; k < 4; k++) {
        const [a, b] = [corners[k], corners[(k + 1) % 4]], [va, vb] = [at(...a), at(...b)];
        if (va < value === vb < value || !Number.isFinite(va + vb)) continue;
        const t = (value - va) / (vb - va);
        cuts.push([place(a[0] + t * (b[0] - a[0])), size - place(a[1] + t * (b[1] - a[1]))]);
      }
      for (let k = 0; k + 1 < cuts.length; k += 2) {
        context.moveTo(...cuts[k]);
        context.lineTo(...cuts[k + 1]);
      }
    }
}
