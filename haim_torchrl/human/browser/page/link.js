// The connection to the simulator: opens, answers, notices silence, comes back.

const FINAL = new Set([4001, 4007, 4008]); // replaced, malformed, flooded: the person decides
const SILENCE = 3000; // ms without a word, with two pings a second, after which the line is dead

export class Link {
  // handlers: scene(message), frame(message), seat(message), refused(reason), state(name, text, final)
  constructor(handlers) {
    this.handlers = handlers;
    this.socket = null;
    this.wait = 300;
    this.frames = 0;
    this.heard = 0;
    this.ended = null; // the reason, once the run has ended
    setInterval(() => this.watch(), 500);
  }

  get open() {
    return this.socket !== null && this.socket.readyState === WebSocket.OPEN;
  }

  connect() {
    clearTimeout(this.timer);
    const address = new URL("ws", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = "";
    const token = new URLSearchParams(location.search).get("token");
    if (token !== null) address.searchParams.set("token", token);
    address.searchParams.set("client", identity());
    const socket = new WebSocket(address);
    this.socket = socket;
    this.heard = performance.now();
    socket.onopen = () => {
      this.frames = 0;
      this.wait = 300;
      this.ended = null;
      this.handlers.state("open", "Connected", false);
    };
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = (event) => this.lose(socket, event);
  }

  send(message) {
    if (this.open) this.socket.send(JSON.stringify(message));
  }

  take(message) {
    this.heard = performance.now();
    if (message.type === "ping") {
      this.send({ type: "pong", t: message.t });
    } else if (message.type === "frame") {
      this.frames += 1;
      this.send({ type: "seen", n: this.frames });
      this.handlers.frame(message);
    } else if (message.type === "refused") {
      this.handlers.refused(message.reason);
    } else if (message.type === "scene" || message.type === "seat") {
      this.handlers[message.type](message);
    }
  }

  async lose(socket, event) {
    if (socket !== this.socket) return;
    this.socket = null;
    const final = FINAL.has(event.code);
    if (event.code === 1001 && event.reason !== "") this.ended = event.reason;
    const ended = this.ended !== null && !final; // and stays so until there is a connection again
    this.handlers.state(ended ? "ended" : "lost", ended ? this.ended : event.reason, final);
    if (final) return;
    this.timer = setTimeout(() => this.connect(), ended ? 2000 : this.wait);
    this.wait = Math.min(2 * this.wait, 3000);
    if (event.code === 1006 && !event.wasClean) await this.ask();
  }

  // A connection refused with a reason looks like any other failure to a page: ask for the reason.
  async ask() {
    try {
      const answer = await fetch(location.href, { cache: "no-store" });
      if (answer.status === 403 && !this.open) {
        clearTimeout(this.timer);
        this.handlers.state("lost", await answer.text(), true);
      }
    } catch {
      // The simulator is not there; the next attempt is under way.
    }
  }

  watch() {
    if (this.socket === null || performance.now() - this.heard < SILENCE) return;
    const socket = this.socket;
    this.lose(socket, { code: 1006, reason: "", wasClean: true });
    socket.close();
  }
}

// By this name the server knows a page that comes back; it lives as long as the tab.
function identity() {
  let name = sessionStorage.getItem("haim-client");
  if (name === null) {
    name = Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) =>
      byte.toString(16).padStart(2, "0"),
    ).join("");
    sessionStorage.setItem("haim-client", name);
  }
  return name;
}
