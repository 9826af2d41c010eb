// Figures and flags. Each value is also there as it was sent, in data-value.

const $ = (id) => document.getElementById(id);
const DRIVERS = { agent: "Agent drives", person: "Person drives", fallback: "Fallback drives" };

export class Hud {
  scene(scene) {
    const blocks = scene.blocks.map((block) => block.replace("t_junction", "T-junction").replaceAll("_", " ")).join(", ");
    const obstacles = `${scene.obstacles} obstacle${scene.obstacles === 1 ? "" : "s"}`;
    this.place = [`scenario ${scene.scenario}`, blocks, obstacles].filter(Boolean).join(" · ");
    $("hud").dataset.scenario = scene.scenario;
    for (const name of ["takeover-cost", "d-cost"]) $(`last-${name}`).textContent = "";
  }

  frame(frame, driving) {
    const you = driving && frame.driver === "person";
    $("driver").dataset.driver = frame.driver;
    $("driver").textContent = you ? "You drive" : DRIVERS[frame.driver];
    flag("takeover", frame.takeover, "person");
    flag("disturbance", frame.disturbance, "bad");
    put("velocity", frame.speed === null ? "–" : `${frame.speed.toFixed(1)} m/s`, frame.speed);
    cost("cost", frame.cost, 0);
    cost("takeover-cost", frame.takeover_cost, 2);
    cost("d-cost", frame.disturbance_cost, 2);
    for (const [name, place] of [["acceleration", 0], ["steering", 1]]) {
      gauge(name, "agent", frame.action_agent[place], false);
      gauge(name, "person", frame.action_mentor[place], !frame.takeover);
    }
    platoon(frame.follower_speeds);
    put("successes", `${frame.successes} of ${frame.episodes}`, frame.successes);
    put("violations", frame.violations);
    put("takeover-rate", `${(100 * frame.takeover_rate).toFixed(1)} %`, frame.takeover_rate);
    put("takeovers", frame.takeovers);
    put("steps", frame.total_steps ? `${frame.steps} / ${frame.total_steps}` : frame.steps, frame.steps);
    put("time-left", frame.seconds_left === null ? "–" : clock(frame.seconds_left), frame.seconds_left);
    put("episodes", frame.episodes);
    put("device-ok", frame.device_ok ? "works" : "lost", frame.device_ok);
    put("latency", frame.latency_ms === null ? "–" : `${frame.latency_ms.toFixed(0)} ms`, frame.latency_ms);
    $("hud-hint").textContent = frame.hint;
    $("caption").textContent = `Episode ${frame.episode} · step ${frame.step} · ${this.place ?? ""}`;
    const root = $("hud");
    root.dataset.driver = frame.driver;
    root.dataset.notice = frame.notice ?? "";
    root.dataset.episode = frame.episode;
    root.dataset.step = frame.step;
  }
}

function put(name, text, value = text) {
  const place = $(`hud-${name}`);
  place.textContent = text;
  place.dataset.value = String(value);
}

function flag(name, on, color) {
  put(name, on ? "Yes" : "No", on);
  $(`hud-${name}`).parentElement.dataset.on = on ? color : "";
}

// Costs come for a single step: the last one stays in small print.
function cost(name, value, digits) {
  const tiny = value > 0 && value < 0.5 * 10 ** -digits;
  const text = value === null ? "–" : tiny ? `< ${(10 ** -digits).toFixed(digits)}` : value.toFixed(digits);
  put(name, text, value);
  $(`hud-${name}`).parentElement.dataset.on = value > 0 ? "bad" : "";
  const last = $(`last-${name}`);
  if (last !== null && value > 0) last.textContent = `last ${text}`;
}

function gauge(name, who, value, idle) {
  const row = $(`gauge-${name}`).querySelector(`.row.${who}`);
  const size = Math.max(-1, Math.min(1, value ?? 0));
  const bar = row.querySelector(".bar i");
  bar.style.left = `${50 + 50 * Math.min(size, 0)}%`;
  bar.style.width = `${50 * Math.abs(size)}%`;
  row.classList.toggle("idle", idle);
  put(`${name}-${who}`, idle || value === null ? "–" : value.toFixed(2), value);
}

function platoon(speeds) {
  const root = $("hud-followers");
  while (root.children.length > speeds.length) root.lastChild.remove();
  while (root.children.length < speeds.length) root.append(document.createElement("span"));
  speeds.forEach((speed, row) => {
    root.children[row].textContent = speed === null ? "–" : speed.toFixed(1);
    root.children[row].dataset.value = String(speed);
  });
}

function clock(seconds) {
  const whole = Math.ceil(seconds);
  const pad = (value) => String(value).padStart(2, "0");
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
  return hours ? `${hours}:${pad(minutes)}:${pad(whole % 60)}` : `${minutes}:${pad(whole % 60)}`;
}
