// Ties the page together: what comes goes to view and figures, what the person does goes out.

import { Controls } from "./controls.js";
import { Hud } from "./hud.js";
import { Link } from "./link.js";
import { MappingDialog } from "./mapping.js";
import { Motion } from "./motion.js";
import { View } from "./view.js";

const HEARTBEAT = 33; // ms
const POLL = 16; // ms between two looks at a gamepad
const $ = (id) => document.getElementById(id);

const view = new View($("canvas"));
const motion = new Motion();
const hud = new Hud();
let seat = { driving: false, free: false, watchers: 0, paused: false };
let line = { name: "connecting", text: "", final: false };
let frame = null;
let sent = { text: "", at: 0 };

const link = new Link({
  scene(message) {
    view.scene(message);
    motion.reset();
    hud.scene(message);
  },
  frame(message) {
    const again = frame !== null && frame.episode === message.episode && frame.step === message.step;
    frame = message;
    motion.take(message, performance.now());
    if (!again) view.mark(message);
    view.stale = true;
    hud.frame(message, seat.driving);
    banner();
  },
  seat(message) {
    seat = message;
    say("");
    roles();
  },
  refused: say,
  state(name, text, final) {
    line = { name, text, final };
    if (name !== "open") {
      seat = { ...seat, driving: false, free: false };
      controls.release(); // nothing may stick until the connection is back
    }
    roles();
  },
});
const controls = new Controls(() => report(false));
const mapping = new MappingDialog(controls.pads, devices);

// Positions of the controls: at once when they change, else as a heartbeat. A page that nobody sees
// is silent after it has let go, so that the simulator knows that nobody watches.
let silent = false;
function report(beat) {
  if (!seat.driving || !link.open) return;
  if (silent && document.hidden) return;
  const read = controls.read();
  const text = JSON.stringify(read);
  const now = performance.now();
  if (!beat && (text === sent.text || now - sent.at < 5)) return;
  sent = { text, at: now };
  silent = document.hidden;
  link.send({ type: "input", ...read, t: now });
}
setInterval(() => report(true), HEARTBEAT);
setInterval(() => {
  if (controls.pads.list().length > 0) report(false);
}, POLL);
setInterval(devices, 500);

function devices() {
  const unknown = controls.pads.unknown();
  $("set-up").hidden = unknown === null;
  $("set-up").onclick = () => mapping.open(unknown);
  const [pad] = controls.pads.list();
  $("hud-input").textContent = pad ? `Device: ${pad.id}` : "";
}

function roles() {
  const open = line.name === "open";
  $("link").dataset.state = open ? "open" : line.name === "connecting" ? "connecting" : "lost";
  $("hud-connection").textContent = open ? "Connected" : line.name === "ended" ? "Run ended" : line.name === "connecting" ? "Connecting" : "Connection lost";
  const watchers = seat.watchers ? ` · ${seat.watchers} watching` : "";
  $("hud-role").textContent = !open ? "–" : seat.driving ? `You are the driver${watchers}`
    : seat.free ? `Nobody drives${watchers}` : `Someone else drives${watchers}`;
  $("hud-role-short").textContent = !open || seat.driving ? "" : seat.free ? "nobody drives" : "someone else drives";
  $("hud-role").dataset.role = seat.driving ? "driver" : "watcher";
  $("drive").hidden = !open || seat.driving || !seat.free;
  $("pause").disabled = $("quit").disabled = !open || !seat.driving;
  $("pause").textContent = seat.paused ? "Resume" : "Pause";
  $("pause").classList.toggle("main", seat.paused && seat.driving);
  banner();
}

// The large words: why nothing moves, or why what moves is not the person's doing.
function banner() {
  let [title, text, kind, button] = ["", "", "", ""];
  const notice = frame?.notice ?? null;
  if (line.name === "ended") [title, text] = [line.text, "The page connects again when the next one begins."];
  else if (line.name === "lost" && line.final) [title, text, kind, button] = ["Disconnected", line.text, "bad", "Connect again"];
  else if (line.name === "lost") [title, text, kind] = ["Connection lost", "Trying to connect again", "bad"];
  else if (line.name === "connecting") title = "Connecting";
  else if (notice === "paused") [title, text] = ["Paused", seat.driving ? "Press Resume to go on." : ""];
  else if (notice !== null) title = notice[0].toUpperCase() + notice.slice(1);
  else if (frame === null) title = "Waiting for the simulator";
  else if (frame.driver === "fallback") [title, text, kind] = ["The fallback drives", "The driver's device does not answer.", "bad"];
  $("banner").hidden = title === "";
  $("banner").dataset.kind = kind;
  $("banner-title").textContent = title;
  $("banner-text").textContent = text;
  $("banner-button").hidden = button === "";
  $("banner-button").textContent = button;
}

let saying;
function say(text) {
  $("hud-refused").textContent = text;
  clearTimeout(saying);
  if (text !== "") saying = setTimeout(() => say(""), 6000);
}

function press(id, action) {
  $(id).addEventListener("click", () => {
    $(id).blur(); // the space bar drives
    action();
  });
}
press("pause", () => link.send({ type: seat.paused ? "resume" : "pause" }));
press("drive", () => {
  controls.release(); // what is held now was not meant to drive
  link.send({ type: "drive" });
});
press("quit", () => $("quit-dialog").showModal());
press("banner-button", () => link.connect());
press("zoom-in", () => view.zoom(1 / 1.25));
press("zoom-out", () => view.zoom(1.25));
press("touch-toggle", () => touch($("touch").hidden));
$("quit-dialog").addEventListener("close", () => {
  if ($("quit-dialog").returnValue === "yes") link.send({ type: "quit" });
  $("quit-dialog").returnValue = "";
});
function touch(on) {
  $("touch").hidden = !on;
  document.body.classList.toggle("touch", on);
}
touch(matchMedia("(pointer: coarse)").matches);

function draw(now) {
  view.draw(motion.at(now), now, motion.moving(now));
  requestAnimationFrame(draw);
}
requestAnimationFrame(draw);
roles();
link.connect();
