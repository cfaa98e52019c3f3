// The socket to the server: tries again when it is lost, and says nothing while it is.

const AGAIN_MS = 1000;
const HEAD_BYTES = 4;
const PART_BYTES = 5;

function parsed(text) {
  try { return JSON.parse(text); } catch (error) { console.warn(`a line that is none: ${error}`); return null; }
}

export class Link {
  constructor(hears) {
    this.hears = hears; // say -> function(message); "pictures", "line"
    this.socket = null;
    this.left = false;
    addEventListener("pagehide", () => this.leave());
    addEventListener("pageshow", (event) => {
      if (event.persisted) { this.left = false; this.open(); }
    });
    this.open();
  }

  get there() {
    return this.socket !== null && this.socket.readyState === WebSocket.OPEN;
  }

  open() {
    const token = new URLSearchParams(location.search).get("token");
    const query = token ? `?token=${encodeURIComponent(token)}` : "";
    const socket = new WebSocket(`ws://${location.host}/socket${query}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.hears.line("open");
    socket.onmessage = (event) => this.hear(event.data);
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      this.hears.line("lost");
      if (!this.left) setTimeout(() => this.open(), AGAIN_MS);
    };
    this.socket = socket;
  }

  leave() {
    this.left = true;
    if (this.socket) this.socket.close();
  }

  say(say, more = {}) {
    if (this.there) this.socket.send(JSON.stringify({ say, ...more }));
  }

  hear(data) {
    if (typeof data === "string") {
      const message = parsed(data);
      if (message && Object.hasOwn(this.hears, message.say)) this.hears[message.say](message);
      return;
    }
    const view = new DataView(data);
    const parts = {};
    for (let at = HEAD_BYTES; at + PART_BYTES <= data.byteLength;) {
      const letter = String.fromCharCode(view.getUint8(at));
      const size = view.getUint32(at + 1, true);
      at += PART_BYTES;
      parts[letter] = data.slice(at, at + size);
      at += size;
    }
    this.hears.pictures(view.getUint32(0, true), parts);
  }
}
