// The top view: the automated vehicle below the middle, its heading up.

const AHEAD = 0.62; // of the height
const TRAIL = 400;

export class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.metres = Number(localStorage.getItem("haim-metres")) || (canvas.clientHeight < 500 ? 70 : 110); // from top to bottom
    this.surfaces = [];
    this.lines = [];
    this.trail = [];
    this.turn = null;
    this.drawn = 0;
    this.stale = true; // whether something other than time asks for a new picture
    new ResizeObserver(() => (this.stale = true)).observe(canvas);
    this.theme();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.theme());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.1 : 1 / 1.1);
    }, { passive: false });
  }

  theme() {
    const style = getComputedStyle(document.documentElement);
    this.color = (name) => style.getPropertyValue(`--${name}`).trim();
    const names = ["grass", "asphalt", "edge", "marking", "route", "scene-agent", "scene-person",
      "scene-fallback", "scene-follower", "scene-traffic", "scene-obstacle"];
    this.colors = Object.fromEntries(names.map((name) => [name.replace("scene-", ""), this.color(name)]));
    this.stale = true;
  }

  zoom(factor) {
    this.metres = Math.max(40, Math.min(300, this.metres * factor));
    localStorage.setItem("haim-metres", String(this.metres));
    this.stale = true;
  }

  scene(scene) {
    const roads = scene.road.filter((line) => line.kind !== "route" && line.points.length > 1);
    // Lines that run side by side, one after the other in the list, have road between them.
    this.surfaces = [];
    for (let k = 1; k < roads.length; k++) {
      const [a, b] = [roads[k - 1].points, roads[k].points];
      if (near(a[0], b[0]) && near(a.at(-1), b.at(-1))) {
        this.surfaces.push(path([...a, ...[...b].reverse()], true));
      }
    }
    this.lines = scene.road.map((line) => ({ kind: line.kind, path: path(line.points, false) }));
    this.trail = [];
    this.turn = null;
    this.stale = true;
  }

  mark(frame) {
    this.stale = true;
    if (!frame.vehicle) return;
    this.trail.push([frame.vehicle[0], frame.vehicle[1], frame.driver]);
    if (this.trail.length > TRAIL) this.trail.shift();
  }

  draw(frame, now, moving) {
    if (!moving && !this.stale) return;
    this.stale = false;
    const { canvas, context: c } = this;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.fillStyle = this.colors.grass;
    c.fillRect(0, 0, width, height);
    if (frame === null || !frame.vehicle) return;

    const [x, y, heading] = frame.vehicle;
    const passed = Math.min(now - this.drawn, 100);
    this.drawn = now;
    if (this.turn === null) this.turn = heading;
    const error = Math.atan2(Math.sin(heading - this.turn), Math.cos(heading - this.turn));
    this.turn += error * (1 - Math.exp(-passed / 180));
    if (Math.abs(error) > 0.002) this.stale = true; // the view is still turning
    const scale = height / this.metres;
    c.translate(width / 2, height * AHEAD);
    c.rotate(this.turn - Math.PI / 2);
    c.scale(scale, -scale);
    c.translate(-x, -y);

    this.road(c);
    this.path(c, x, y);
    for (const box of frame.obstacles) this.obstacle(c, box);
    for (const box of frame.traffic) this.car(c, box, this.colors.traffic);
    for (const box of frame.followers) this.car(c, box, this.colors.follower);
    this.car(c, frame.vehicle, this.colors[frame.driver], true);
    this.speeds(c, frame, ratio, width);
  }

  road(c) {
    c.lineJoin = "round";
    c.fillStyle = c.strokeStyle = this.colors.asphalt;
    c.lineWidth = 0.5;
    for (const surface of this.surfaces) {
      c.fill(surface);
      c.stroke(surface);
    }
    for (const kind of ["route", "marking", "edge"]) {
      c.strokeStyle = this.colors[kind];
      c.lineWidth = kind === "route" ? 1.3 : kind === "edge" ? 0.32 : 0.2;
      c.globalAlpha = kind === "route" ? 0.4 : 1;
      c.setLineDash(kind === "marking" ? [3, 4] : []);
      for (const line of this.lines) if (line.kind === kind) c.stroke(line.path);
    }
    c.setLineDash([]);
    c.globalAlpha = 1;
  }

  // Where the vehicle came from, in the colour of who drove.
  path(c, x, y) {
    c.lineWidth = 0.45;
    c.globalAlpha = 0.75;
    const points = [...this.trail, [x, y, this.trail.at(-1)?.[2] ?? "agent"]];
    for (let k = 1; k < points.length; k++) {
      const driver = points[k][2];
      c.strokeStyle = this.colors[driver];
      c.beginPath();
      c.moveTo(points[k - 1][0], points[k - 1][1]);
      for (; k < points.length && points[k][2] === driver; k++) c.lineTo(points[k][0], points[k][1]);
      c.stroke();
      k -= 1;
    }
    c.globalAlpha = 1;
  }

  car(c, box, color, own = false) {
    if (!box) return;
    const [x, y, heading, length, width] = box;
    c.save();
    c.translate(x, y);
    c.rotate(heading);
    c.fillStyle = color;
    if (own) {
      c.globalAlpha = 0.3;
      c.beginPath();
      c.roundRect(-length / 2 - 0.8, -width / 2 - 0.8, length + 1.6, width + 1.6, 1.4);
      c.fill();
      c.globalAlpha = 1;
    }
    c.beginPath();
    c.roundRect(-length / 2, -width / 2, length, width, Math.min(0.6, 0.3 * width));
    c.fill();
    c.lineWidth = own ? 0.22 : 0.12;
    c.strokeStyle = own ? "#ffffff" : "#10151a";
    c.stroke();
    c.fillStyle = "#10151ab8"; // windscreen and rear window
    c.fillRect(0.1 * length, -0.38 * width, 0.14 * length, 0.76 * width);
    c.fillRect(-0.36 * length, -0.36 * width, 0.09 * length, 0.72 * width);
    c.restore();
  }

  obstacle(c, box) {
    if (!box) return;
    const [x, y, heading, length, width] = box;
    c.save();
    c.translate(x, y);
    c.rotate(heading);
    c.beginPath();
    c.rect(-length / 2, -width / 2, length, width);
    c.fillStyle = this.colors.obstacle;
    c.fill();
    c.clip();
    c.strokeStyle = "#10151a";
    c.lineWidth = 0.35;
    for (let at = -length - width; at < length + width; at += 1.1) {
      c.beginPath();
      c.moveTo(at, -width / 2);
      c.lineTo(at + width, width / 2);
      c.stroke();
    }
    c.restore();
    c.save();
    c.translate(x, y);
    c.rotate(heading);
    c.lineWidth = 0.15;
    c.strokeStyle = "#10151a";
    c.strokeRect(-length / 2, -width / 2, length, width);
    c.restore();
  }

  // Speeds of the followers beside them, upright.
  speeds(c, frame, ratio, width) {
    const transform = c.getTransform();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.font = "600 12px system-ui, sans-serif";
    c.textBaseline = "middle";
    frame.followers.forEach((box, row) => {
      const speed = frame.follower_speeds[row];
      if (!box || speed === null || speed === undefined) return;
      const at = transform.transformPoint({ x: box[0], y: box[1] });
      const text = speed.toFixed(1);
      const size = c.measureText(text).width + 10;
      const side = (1.2 * transform.a ** 2 + 1.2 * transform.b ** 2) ** 0.5 / ratio;
      const left = Math.min(at.x / ratio + side + 8, width - size - 4);
      c.fillStyle = "#1a2128d9";
      c.beginPath();
      c.roundRect(left, at.y / ratio - 9, size, 18, 5);
      c.fill();
      c.fillStyle = this.colors.follower;
      c.fillText(text, left + 5, at.y / ratio + 0.5);
    });
  }
}

function near(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1]) < 7;
}

function path(points, closed) {
  const line = new Path2D();
  points.forEach(([x, y], k) => (k === 0 ? line.moveTo(x, y) : line.lineTo(x, y)));
  if (closed) line.closePath();
  return line;
}
