// Keys, touch and gamepads as one set of controls.

import { Pads } from "./pads.js";

const KEYS = {
  ArrowLeft: "left", KeyA: "left", ArrowRight: "right", KeyD: "right",
  ArrowUp: "up", KeyW: "up", ArrowDown: "down", KeyS: "down", Space: "takeover",
};
const RELEASED = { steering: 0, throttle: 0, brake: 0, takeover: false };

export class Controls {
  // changed() is called when a key or a finger moves
  constructor(changed) {
    this.changed = changed;
    this.pressed = new Set();
    this.touch = { ...RELEASED };
    this.pads = new Pads();
    this.present = true; // whether the page is in front of the person
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => this.leave());
    addEventListener("focus", () => this.arrive());
    document.addEventListener("visibilitychange", () => (document.hidden ? this.leave() : this.arrive()));
    this.fingers();
  }

  // Positions of the controls, and what they are.
  read() {
    if (!this.present) return { ...RELEASED, kind: "keys" };
    const keys = this.pressed;
    if (keys.size > 0) {
      const held = (name) => Number([...keys].some((code) => KEYS[code] === name));
      return {
        steering: held("right") - held("left"), throttle: held("up"), brake: held("down"),
        takeover: held("takeover") === 1, kind: "keys",
      };
    }
    const touch = this.touch;
    if (touch.steering || touch.throttle || touch.brake || touch.takeover) {
      return { ...touch, kind: "gamepad" }; // it springs back and moves by degrees
    }
    return this.pads.read() ?? { ...RELEASED, kind: "keys" };
  }

  release() {
    this.pressed.clear();
    this.touch = { ...RELEASED };
    document.querySelectorAll("#touch .held").forEach((part) => part.classList.remove("held"));
    document.getElementById("knob").style.transform = "";
  }

  leave() {
    this.present = false;
    this.release();
    this.changed();
  }

  arrive() {
    this.present = true;
    this.changed();
  }

  key(event, down) {
    if (!(event.code in KEYS) || event.ctrlKey || event.metaKey || event.altKey) {
      if (!down && this.pressed.delete(event.code)) this.changed();
      return;
    }
    if (document.querySelector("dialog[open]") !== null) return;
    event.preventDefault(); // neither scrolls nor presses a button
    if (event.repeat) return; // a key held since before a loss of focus must be pressed anew
    if (down) this.pressed.add(event.code);
    else this.pressed.delete(event.code);
    this.changed();
  }

  fingers() {
    const pad = document.getElementById("pad");
    const knob = document.getElementById("knob");
    const steer = (event) => {
      const box = pad.getBoundingClientRect();
      const reach = (box.width - 60) / 2;
      const moved = event.clientX - (box.left + box.width / 2);
      this.touch.steering = Math.max(-1, Math.min(1, moved / reach));
      knob.style.transform = `translateX(${this.touch.steering * reach}px)`;
      this.changed();
    };
    hold(pad, steer, () => {
      this.touch.steering = 0;
      knob.style.transform = "";
      this.changed();
    });
    pad.addEventListener("pointermove", (event) => {
      if (pad.hasPointerCapture(event.pointerId)) steer(event);
    });
    for (const [name, on, off] of [["throttle", 1, 0], ["brake", 1, 0], ["takeover", true, false]]) {
      const set = (value) => () => {
        this.touch[name] = value;
        this.changed();
      };
      hold(document.getElementById(`touch-${name}`), set(on), set(off));
    }
  }
}

function hold(element, press, release) {
  element.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    element.setPointerCapture(event.pointerId);
    element.classList.add("held");
    press(event);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    element.addEventListener(name, (event) => {
      if (!element.classList.contains("held")) return;
      element.classList.remove("held");
      release(event);
    });
  }
  element.addEventListener("contextmenu", (event) => event.preventDefault());
}
