// Keys, gamepads and 3-D mice move the tip: twenty times a second the page sends its velocity to the server.
"use strict";

// Unit vectors along the axes of the plate; W, A, S, D, Q, E and the arrows are the camera's.
const KEYS = {
  KeyL: [1, 0, 0], KeyJ: [-1, 0, 0],
  KeyI: [0, 1, 0], KeyK: [0, -1, 0],
  KeyU: [0, 0, 1], KeyO: [0, 0, -1],
};
const PERIOD = 50; // ms
const DEAD = 0.12; // of a stick that is let go
const SLOW = 0.2; // with Shift
const MOUSE = /3dconnexion|space ?(mouse|navigator|pilot|explorer)/i;

// What a stick means, without its dead zone.
function bent(value) {
  const size = Math.abs(value ?? 0);
  return size <= DEAD ? 0 : Math.sign(value) * Math.min((size - DEAD) / (1 - DEAD), 1);
}

// The velocity of the tip as a share of the greatest, of a set of key codes and of gamepads.
function motion(keys, pads) {
  const v = [0, 0, 0];
  for (const key of keys) (KEYS[key] ?? v.map(() => 0)).forEach((x, k) => { v[k] += x; });
  for (const pad of pads) {
    if (!pad) continue;
    const a = pad.axes.map(bent);
    // A 3-D mouse is pushed right, pulled near and pressed down; a gamepad has y on its left stick, z on its right one.
    const [x, y, z] = MOUSE.test(pad.id) ? [a[0], a[1], a[2]] : [a[0], a[1], a[3]];
    v[0] += x ?? 0;
    v[1] -= y ?? 0;
    v[2] -= z ?? 0;
  }
  const size = Math.hypot(...v);
  const slower = keys.has("ShiftLeft") || keys.has("ShiftRight") ? SLOW : 1;
  return v.map((x) => (x * slower) / Math.max(size, 1) + 0);
}

function start() {
  const keys = new Set();
  let socket = null;
  let moved = false;
  const typing = (event) => event.target.closest?.("input:not([type=checkbox]), textarea, [contenteditable=true]");
  addEventListener("keydown", (event) => { if (!typing(event)) keys.add(event.code); });
  addEventListener("keyup", (event) => keys.delete(event.code));
  addEventListener("blur", () => keys.clear());
  setInterval(() => {
    // Which robot is meant; there while the box in the panel is ticked.
    const tab = document.querySelector("[data-hand]")?.dataset.hand;
    if (!tab) {
      socket?.close();
      socket = null;
      return;
    }
    if (!socket || socket.readyState > WebSocket.OPEN) {
      socket = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/hand`);
    }
    if (socket.readyState !== WebSocket.OPEN) return;
    const velocity = motion(keys, navigator.getGamepads());
    const moves = velocity.some((x) => x !== 0);
    if (moves || moved) socket.send(JSON.stringify({ tab, velocity }));
    moved = moves;
  }, PERIOD);
}

if (typeof module === "undefined") start();
else module.exports = { motion };
