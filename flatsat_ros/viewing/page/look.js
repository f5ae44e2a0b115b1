// Colours, names of the flight modes, and how numbers are written.

const MODES = ["IDLE", "UNLOCK", "FLY", "LEVEL", "CUT", "REST", "DESCEND", "FALLEN"];
// white text on them can be read
const MODE_COLOURS = ["#66717c", "#1f6fb2", "#007a59", "#8f6200", "#4a1c2a", "#4f7a6b", "#b84c00", "#a4003b"];

// what does not hold of what a certificate of flight assumes, by the number in the telemetry
const ASSUMPTIONS = [
  "", "pose too old", "ticks not even", "poses not where expected", "disturbance too large", "disturbance changes too fast",
  "reference asks for too much", "gain outside its interval", "not back in its tube yet", "outside its tube",
  "late or early to follow",
];

/** Of COLOURS, which the page begins with; further drones get them again, with dashes. */
function colourOf(index) {
  return COLOURS[index % COLOURS.length];
}

function dashOf(index) {
  return [[], [6, 4], [2, 3], [10, 3, 2, 3]][Math.floor(index / COLOURS.length) % 4];
}

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "class") made.className = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value);
  }
  // text stays text: names come from messages
  made.append(...children);
  return made;
}

/** A text, cut at its end if it is longer than that many characters: where it stands shortened, the whole is not far. */
function shortened(text, most) {
  return text.length > most ? `${text.slice(0, Math.max(1, most - 1))}…` : text;
}

function written(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (typeof value !== "number") return String(value);
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "-∞";
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(2) : String(Number(value.toPrecision(digits)));
}

function clock(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(2).padStart(5, "0")}`;
}

function style(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** Turn light into dark and back. */
function switchTheme() {
  const root = document.documentElement;
  const isDark = (root.dataset.theme || (window.matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  root.dataset.theme = isDark ? "light" : "dark";
}
