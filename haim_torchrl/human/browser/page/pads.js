// Gamepads and wheels: which one drives, and what its axes and buttons mean.

const STORE = "haim-mapping:";
const WHEEL = /wheel|g25|g27|g29|g920|g923|driving force|fanatec|csl|t\d{2,3}\s?(rs|gt|rw)/i;

export class Pads {
  constructor() {
    this.live = new Map(); // pad and pedal -> whether it was seen at rest
  }

  list() {
    return [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad !== null && pad.connected);
  }

  // Positions of the first device whose axes are known; null if there is none.
  read() {
    for (const pad of this.list()) {
      const mapping = stored(pad.id);
      if (mapping !== null) return this.mapped(pad, mapping);
      if (pad.mapping === "standard") return standard(pad);
    }
    return null;
  }

  // A device that must be set up first; null if there is none.
  unknown() {
    return this.list().find((pad) => pad.mapping !== "standard" && stored(pad.id) === null) ?? null;
  }

  mapped(pad, mapping) {
    return {
      steering: steering(pad, mapping.steering),
      throttle: this.pedal(pad, mapping, "throttle"),
      brake: this.pedal(pad, mapping, "brake"),
      takeover: mapping.takeover !== null && position(pad, mapping.takeover) > 0.5,
      kind: mapping.kind,
    };
  }

  // Browsers report 0 for an axis that has not moved yet, which for a pedal that rests at 1 or -1
  // would be half pressed: a pedal counts from when it was seen at rest.
  pedal(pad, mapping, name) {
    const part = mapping[name];
    if (part === null) return 0;
    const key = `${pad.index} ${name}`;
    const pressed = fraction(position(pad, part), part.rest, part.full);
    if (pressed < 0.1) this.live.set(key, true);
    return this.live.get(key) ? pressed : 0;
  }
}

export function isWheel(id) {
  return WHEEL.test(id);
}

export function stored(id) {
  try {
    return JSON.parse(localStorage.getItem(STORE + id));
  } catch {
    return null;
  }
}

export function store(id, mapping) {
  localStorage.setItem(STORE + id, JSON.stringify(mapping));
}

// The layout that browsers call standard: left stick, triggers, A or a bumper to take over.
export function standard(pad) {
  const value = (index) => clip(pad.buttons[index]?.value ?? 0, 0, 1);
  return {
    steering: clip(pad.axes[0] ?? 0, -1, 1),
    throttle: value(7),
    brake: value(6),
    takeover: [0, 4, 5].some((index) => pad.buttons[index]?.pressed),
    kind: "gamepad",
  };
}

// Which part moved most between two states of a device; null if none moved far.
export function moved(before, after, except = null) {
  let best = null;
  let most = 0.3;
  const look = (type) => (value, index) => {
    const from = before[type][index] ?? 0;
    if (except !== null && except.type === type && except.index === index) return;
    if (Math.abs(value - from) > most) {
      most = Math.abs(value - from);
      best = { type, index, rest: from, full: value };
    }
  };
  after.axes.forEach(look("axes"));
  after.buttons.forEach(look("buttons"));
  return best;
}

// The state of a device as plain numbers.
export function state(pad) {
  return { axes: [...pad.axes], buttons: pad.buttons.map((button) => button.value) };
}

export function steering(pad, part) {
  const value = position(pad, part);
  return clip((part.rest - value) / (part.full - part.rest), -1, 1) + 0; // full is to the left
}

export function fraction(value, rest, full) {
  return clip((value - rest) / (full - rest), 0, 1);
}

function position(pad, part) {
  if (part.type === "axes") return pad.axes[part.index] ?? part.rest;
  return pad.buttons[part.index]?.value ?? part.rest;
}

function clip(value, low, high) {
  return Number.isFinite(value) ? Math.max(low, Math.min(high, value)) : 0;
}
