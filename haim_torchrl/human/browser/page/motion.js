// Where things are between two frames: moved on from the newest frame, so that nothing is delayed.

export class Motion {
  constructor() {
    this.reset();
  }

  reset() {
    this.last = null;
    this.before = null;
    this.period = 100; // ms between two frames as they come
    this.arrived = 0;
  }

  take(frame, now) {
    if (this.last !== null && frame.step === this.last.step && frame.episode === this.last.episode) {
      this.last = { ...frame };
      this.before = null; // the same step again: nothing moves
      return;
    }
    const follows = this.last !== null && frame.episode === this.last.episode && frame.step === this.last.step + 1;
    if (follows && this.last.notice === null) {
      const passed = Math.min(Math.max(now - this.arrived, 5), 500);
      this.period += 0.2 * (passed - this.period);
    }
    this.before = follows ? this.last : null;
    this.last = frame;
    this.arrived = now;
  }

  // Whether the picture of a moment ago is out of date.
  moving(now) {
    const moves = this.before !== null && this.last.notice === null;
    return moves && now - this.arrived < this.period + 50;
  }

  // The frame at a time, with boxes moved on by at most one step.
  at(now) {
    const { last, before } = this;
    if (last === null || before === null || last.notice !== null) return last;
    const share = Math.min((now - this.arrived) / this.period, 1);
    const pairs = (name) => {
      const same = last[name].length === before[name].length;
      return last[name].map((box, row) => moveOn(same ? before[name][row] : nearest(box, before[name]), box, share));
    };
    return {
      ...last,
      vehicle: moveOn(before.vehicle, last.vehicle, share),
      followers: pairs("followers"),
      traffic: pairs("traffic"),
      obstacles: pairs("obstacles"),
    };
  }
}

function moveOn(from, to, share) {
  if (!from || !to || Math.hypot(to[0] - from[0], to[1] - from[1]) > 5) return to;
  const turn = Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2]));
  return [
    to[0] + share * (to[0] - from[0]), to[1] + share * (to[1] - from[1]), to[2] + share * turn, to[3], to[4],
  ];
}

function nearest(box, others) {
  let best = null;
  let least = 4;
  for (const other of others) {
    if (!box || !other || other[3] !== box[3] || other[4] !== box[4]) continue;
    const distance = Math.hypot(other[0] - box[0], other[1] - box[1]);
    if (distance < least) [best, least] = [other, distance];
  }
  return best;
}
