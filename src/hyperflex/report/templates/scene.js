// what the player and `hyperflex play` share: the theme, canvases, and the picture of arm, rope and obstacles
const root = document.documentElement, colour = {};
const dark = matchMedia("(prefers-color-scheme: dark)");
function fit(c) { // canvas to its size on the screen; returns its width and height, CSS pixels
  const ratio = window.devicePixelRatio || 1, w = c.clientWidth, h = c.clientHeight;
  if (c.width !== Math.round(w * ratio) || c.height !== Math.round(h * ratio)) { c.width = Math.round(w * ratio); c.height = Math.round(h * ratio); }
  c.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
  return [w, h];
}
function readColours() { const style = getComputedStyle(root); for (const name of ["ink", "soft", "line", "rope", "tip", "arm", "trail", "peg", "obstacle", "ground", "a", "b", "c"]) colour[name] = style.getPropertyValue("--" + name).trim(); }
// pixels of places, m, in a canvas of w by h pixels that shows all of a view [x0, y0, x1, y1], m
function mapping([x0, y0, x1, y1], w, h) {
  const scale = Math.min(w / (x1 - x0), h / (y1 - y0));
  return { scale, X: (x) => w / 2 + scale * (x - (x0 + x1) / 2), Y: (y) => h / 2 - scale * (y - (y0 + y1) / 2),
    x: (X) => (X - w / 2) / scale + (x0 + x1) / 2, y: (Y) => (h / 2 - Y) / scale + (y0 + y1) / 2 };
}
// s: view; now: x, y of the shaft (if arm) and the joints, m, the tip last; ghosts: such points of a little earlier, the
// oldest first; path: places of the tip; radius of the rope, m; obstacles, `angle` that of a peg that turns, `avoided`
// those that must not be touched; targets; by choice dots: measured places; others: points of further ropes
function drawScene(pen, w, h, s) {
  const { scale, X, Y } = mapping(s.view, w, h), now = s.now, p = s.arm ? 1 : 0, last = now.length - 2;
  const stroke = (c, width, alpha) => { pen.strokeStyle = c; pen.lineWidth = width; pen.globalAlpha = alpha; pen.stroke(); pen.globalAlpha = 1; };
  const line = (q, from) => { pen.beginPath(); for (let j = from; j < q.length / 2; j++) pen.lineTo(X(q[2 * j]), Y(q[2 * j + 1])); };
  const disc = (x, y, r, c) => { pen.beginPath(); pen.arc(X(x), Y(y), r, 0, 7); pen.fillStyle = c; pen.fill(); };
  pen.clearRect(0, 0, w, h); pen.lineCap = pen.lineJoin = "round";
  pen.beginPath(); pen.moveTo(0, Y(now[1])); pen.lineTo(w, Y(now[1])); pen.moveTo(X(now[0]), 0); pen.lineTo(X(now[0]), h); stroke(colour.line, 1, p);
  for (const o of s.obstacles) {
    const c = o.avoided ? colour.obstacle : colour.peg;
    pen.beginPath();
    if (o.kind === "ground") {
      const n = Math.hypot(o.nx, o.ny), far = 2 * (w + h) / scale, ax = o.nx / n * far, ay = o.ny / n * far;
      for (const [u, v] of [[1, 0], [-1, 0], [-1, -1], [1, -1]]) pen.lineTo(X(o.x + u * ay + v * ax), Y(o.y - u * ax + v * ay));
      pen.closePath(); pen.fillStyle = colour.line; pen.fill(); if (o.avoided) stroke(c, 3, 1);
      continue;
    }
    if (o.kind === "wall") { pen.moveTo(X(o.x), Y(o.y)); pen.lineTo(X(o.x2), Y(o.y2)); stroke(c, 3, 1); continue; }
    const r = Math.max(o.radius * scale, 2);
    disc(o.x, o.y, r, c);
    if (o.angle !== undefined) { pen.beginPath(); pen.moveTo(X(o.x), Y(o.y)); pen.lineTo(X(o.x) + r * Math.cos(o.angle), Y(o.y) - r * Math.sin(o.angle)); stroke(colour.ground, 1.5, 1); }
  }
  s.ghosts.forEach((q, k) => { line(q, p); stroke(colour.rope, 1, 0.42 - 0.08 * (s.ghosts.length - k)); });
  pen.lineCap = "butt";
  const path = s.path.map(([x, y]) => [X(x), Y(y)]), most = path.length - 1;
  const mid = (k) => [(path[k][0] + path[k + 1][0]) / 2, (path[k][1] + path[k + 1][1]) / 2];
  for (let k = 0; k <= most; k++) { // a parabola about each point, from middle to middle
    pen.beginPath(); pen.moveTo(...(k ? mid(k - 1) : path[0])); pen.quadraticCurveTo(...path[k], ...(k < most ? mid(k) : path[most]));
    stroke(colour.trail, 2, 0.15 + 0.75 * k / most);
  }
  pen.lineCap = "round";
  for (const q of s.others || []) { line(q, 0); stroke(colour.a, 1, 0.35); }
  line(now, p); stroke(colour.rope, Math.max(2.5, 2 * s.radius * scale), 1);
  disc(now[last], now[last + 1], 4, colour.tip);
  for (const [x, y] of s.targets) { pen.beginPath(); pen.arc(X(x), Y(y), 8, 0, 7); stroke(colour.peg, 2, 1); }
  for (const [x, y] of s.dots || []) { pen.beginPath(); pen.arc(X(x), Y(y), 6, 0, 7); stroke(colour.peg, 1.8, 1); }
  if (s.arm) { line(now.subarray(0, 4), 0); stroke(colour.arm, 5, 1); }
  disc(now[0], now[1], 5, colour.arm);
  const bar = 10 ** Math.floor(Math.log10(0.4 * w / scale)), right = w - 4, low = h - 6;
  pen.beginPath(); pen.moveTo(right - bar * scale, low); pen.lineTo(right, low); stroke(colour.soft, 1.5, 1);
  pen.fillStyle = colour.soft; pen.font = "12px system-ui, sans-serif"; pen.textAlign = "right"; pen.textBaseline = "alphabetic"; pen.fillText(bar + " m", right, low - 5);
  if (s.obstacles.some((o) => o.avoided)) { pen.textAlign = "left"; pen.fillStyle = colour.obstacle; pen.fillText("\u25a0 obstacles, not to be touched", 4, 14); }
}
