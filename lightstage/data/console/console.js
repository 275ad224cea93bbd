// Keys, sounds, and the journal's lines as they are written. All that is shown comes from the server: without
// a stream of events the page asks every two seconds by itself (hx-trigger in the pages).
"use strict";

const LINES_SHOWN = 200;
const MUTED = "lightstage-muted";

// --- sounds ---------------------------------------------------------------------------------------
// Pitch in Hz and length in seconds, one after the other. A browser lets a page sound after a first key or click.
const SOUNDS = {
  hold: [[392, 0.45]],
  done: [[523, 0.15], [784, 0.3]],
  look: [[880, 0.12], [0, 0.08], [880, 0.12], [0, 0.08], [880, 0.12]],
};
let audio = null;

function muted() {
  return localStorage.getItem(MUTED) === "yes";
}

function unlock() {
  if (!muted() && audio === null) audio = new AudioContext();
}

function play(name) {
  document.body.dataset.sound = name; // for tests
  if (muted() || audio === null || !(name in SOUNDS)) return;
  let at = audio.currentTime + 0.02;
  for (const [pitch, length] of SOUNDS[name]) {
    if (pitch) {
      const tone = audio.createOscillator();
      const loud = audio.createGain();
      tone.frequency.value = pitch;
      loud.gain.setValueAtTime(0, at);
      loud.gain.linearRampToValueAtTime(0.25, at + 0.02);
      loud.gain.linearRampToValueAtTime(0, at + length);
      tone.connect(loud).connect(audio.destination);
      tone.start(at);
      tone.stop(at + length);
    }
    at += length;
  }
}

function showSounds() {
  const button = document.getElementById("sounds");
  button.setAttribute("aria-pressed", String(!muted()));
  button.firstChild.textContent = muted() ? "Sounds off " : "Sounds on ";
}

// --- keys -----------------------------------------------------------------------------------------
const PAGES = { 1: "/plan", 2: "/live", 3: "/devices", 4: "/sessions" };

function pressed(event) {
  unlock();
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.target.matches("input, textarea, select")) return;
  const look = document.getElementById("look");
  // q works from everywhere; an open dialog takes all other keys.
  const button = document.querySelector(`[data-key="${CSS.escape(event.key)}"]`);
  if (look.open && event.key !== "q") return;
  if (button !== null && button.dataset.says) {
    event.preventDefault();
    document.getElementById("message").textContent = button.dataset.says;
  } else if (button !== null) {
    event.preventDefault();
    button.click();
  } else if (event.key in PAGES) {
    location.assign(PAGES[event.key]);
  }
}

// --- events ---------------------------------------------------------------------------------------
function follow(part) {
  let waiting = 0;
  // Begins at the first line that the server keeps: the list shows what happened before, without a sound.
  const shown = Number(part.dataset.after);
  const stream = new EventSource(`${part.dataset.events}?after=0`);
  stream.onmessage = (event) => {
    const line = JSON.parse(event.data);
    if (line.sound && line.id > shown) play(line.sound);
    if (line.text && line.tone !== "quiet") write(line);
    // Lines that come together redraw the page once.
    if (!waiting && !(line.id <= shown)) {
      waiting = setTimeout(() => {
        waiting = 0;
        htmx.trigger(part, "stage");
      }, 150);
    }
  };
  addEventListener("pagehide", () => stream.close());
}

function write(line) {
  const list = document.getElementById("log");
  const item = document.createElement("li");
  item.textContent = `${line.at} ${line.sign} ${line.text.replace(/\.$/, "")}${line.todo ? ". " + line.todo : ""}`;
  list.prepend(item);
  while (list.children.length > LINES_SHOWN) list.lastChild.remove();
}

// What a page shows is old once the console does not answer, or does not know this page any more.
function lost(why) {
  for (const id of ["lost", "unknown"]) document.getElementById(id).hidden = id !== why;
  document.body.classList.toggle("old", why !== "");
}

// A request is sent before the page is left: a stop must not be lost.
let sending = 0;
let going = "";
function leave(url) {
  going = url;
  if (!sending) location.assign(url);
  else setTimeout(() => location.assign(url), 2000);
}
function counted(by) {
  return (event) => {
    if (event.detail.requestConfig.verb !== "post") return;
    sending += by;
    if (!sending && going) location.assign(going);
  };
}

// The message about a key disappears when the state that it was about changes.
let phase = "";
function forget() {
  const banner = document.querySelector("[data-phase]");
  const now = banner === null ? "" : banner.dataset.phase;
  if (now !== phase && phase !== "") document.getElementById("message").textContent = "";
  phase = now;
}

document.addEventListener("DOMContentLoaded", () => {
  showSounds();
  document.getElementById("sounds").addEventListener("click", () => {
    localStorage.setItem(MUTED, muted() ? "no" : "yes");
    unlock();
    showSounds();
  });
  addEventListener("keydown", pressed);
  addEventListener("pointerdown", unlock);
  const part = document.querySelector("[data-events]");
  if (part !== null) follow(part);
  document.body.addEventListener("htmx:sendError", () => lost("lost"));
  document.body.addEventListener("htmx:afterOnLoad", (event) => lost(event.detail.xhr.status === 401 ? "unknown" : ""));
  document.body.addEventListener("htmx:beforeRequest", counted(1));
  document.body.addEventListener("htmx:afterRequest", counted(-1));
  forget();
  document.body.addEventListener("htmx:afterSwap", (event) => {
    forget();
    const look = document.getElementById("look");
    if (event.detail.target === look && !look.open) look.showModal();
    // The capture that was starting has begun: show the page of its session.
    if (location.pathname === "/live" && event.detail.target.id === "part" && event.detail.xhr.responseURL.includes("/session/")) {
      leave(event.detail.xhr.responseURL);
    }
  });
});
