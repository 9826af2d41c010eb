// The dialog in which a person shows what the parts of a wheel or an unknown gamepad do.

import { isWheel, moved, state, store } from "./pads.js";

const STEPS = [
  ["rest", "Move everything once, then let go of it, with the wheel or stick straight."],
  ["steering", "Turn fully to the left and hold."],
  ["throttle", "Press the throttle fully and hold."],
  ["brake", "Press the brake fully and hold."],
  ["takeover", "Hold the button or paddle that is to take over."],
];
const $ = (name) => document.getElementById(`mapping-${name}`);

export class MappingDialog {
  // closed() is called when the dialog has closed
  constructor(pads, closed) {
    this.pads = pads;
    this.dialog = $("dialog");
    $("cancel").onclick = () => this.dialog.close();
    $("next").onclick = () => this.next();
    this.dialog.addEventListener("close", () => {
      clearInterval(this.timer);
      closed();
    });
  }

  open(pad) {
    this.id = pad.id;
    this.step = 0;
    this.found = {};
    $("name").textContent = pad.id;
    $("kind").value = isWheel(pad.id) ? "wheel" : "gamepad";
    this.show();
    this.dialog.showModal();
    this.timer = setInterval(() => this.look(), 50);
  }

  show() {
    $("step").textContent = `${this.step + 1} of ${STEPS.length}: ${STEPS[this.step][1]}`;
    $("next").textContent = this.step === STEPS.length - 1 ? "Save" : "Next";
    this.look();
  }

  // What is moved now; the steering returns by itself and is no pedal.
  look() {
    const pad = this.pads.list().find((each) => each.id === this.id);
    if (pad === undefined) {
      this.dialog.close();
      return null;
    }
    const now = state(pad);
    if (this.step === 0) {
      $("found").textContent = "";
      $("next").disabled = false;
      return now;
    }
    const part = moved(this.found.rest, now, this.found.steering);
    $("found").textContent = part === null ? "Nothing moves yet." : `${part.type === "axes" ? "Axis" : "Button"} ${part.index} moves.`;
    $("next").disabled = part === null;
    return part;
  }

  next() {
    const seen = this.look();
    if (seen === null) return;
    this.found[STEPS[this.step][0]] = seen;
    this.step += 1;
    if (this.step < STEPS.length) {
      this.show();
      return;
    }
    const { steering, throttle, brake, takeover } = this.found;
    store(this.id, { kind: $("kind").value, steering, throttle, brake, takeover });
    this.dialog.close();
  }
}
