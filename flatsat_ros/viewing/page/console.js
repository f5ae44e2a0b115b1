// The page of the console: it shows what the stream tells and sends commands; what was refused is shown with the reason.

const SHOWN = 30; // s, of the curves
const CURVES = 0.5; // s, between two drawings of them
const LOST = 1.5; // s without news, after which the page says so
const AGAIN = 0.25; // s, after which a page for which there was no room asks again
const SLOW = 0.04; // s, that a browser takes to begin to draw, from which on it draws less often:
const REST = 5; // times as long nothing is drawn
const LATE = 0.5; // s, age of a pose that is shown in red
const SILENT = 3.5; // s, age of what is told of a link once a second, after which it is not shown any more
const LATECOMERS = 2.0; // s, that the view waits for the poses of all drones
const SURE = 3.0; // s, within which a second click must come where one could be an accident
// name, what it is, smallest and largest value of the slider, which is logarithmic
const TUNED = [
  ["mu", "μ, 1/s", 0.01, 100],
  ["v_inf", "V∞", 1e-4, 10],
  ["gamma_max", "γ max", 1, 100],
  ["nu", "ν, 1/s", 0.001, 10],
];
const WATCHED = ["Horizontal error", "Vertical error", "V / ε", "Gain γ", "Applied gain k", "Thrust T", "Roll φ", "Pitch θ", "Height z", "Compensated disturbance", "Thrust scale", "Battery", "Tick time"];

class ConsolePage {
  constructor() {
    this.flight = null;
    this.begin = performance.now() / 1000;
    this.heard = -Infinity;
    this.line = 0;
    this.sent = 0; // commands so far
    this.chosen = 0;
    const find = (id) => document.getElementById(id);
    this.parts = Object.fromEntries(["subtitle", "scene", "cards", "timeline", "plots", "said", "log", "whose", "sliders", "goal", "goal-x", "goal-y", "height", "aim", "aimed"].map((id) => [id, find(id)]));
    document.querySelectorAll("header [data-do]").forEach((button) => ConsolePage.guard(button, () => this.send({ do: button.dataset.do, who: "all" })));
    find("look").addEventListener("click", () => this.view && this.view.lookAtAll());
    find("theme").addEventListener("click", () => this.switchTheme());
    this.parts.aim.addEventListener("change", () => this.parts.scene.classList.toggle("aiming", this.parts.aim.checked));
    this.parts.goal.addEventListener("submit", (event) => {
      event.preventDefault();
      this.sendGoal();
    });
    document.addEventListener("keydown", (event) => this.key(event));
    this.makeSliders();
    this.listen();
    setInterval(() => this.watch(), 250);
  }

  now() {
    return performance.now() / 1000 - this.begin;
  }

  /** Let a button that could be hit by accident ask for a second click. */
  static guard(button, act) {
    button.addEventListener("click", () => {
      if (!("sure" in button.dataset)) return act();
      if (!button.classList.contains("sure")) {
        const text = button.textContent;
        button.classList.add("sure");
        button.textContent = "Click again";
        button.calm = setTimeout(() => ConsolePage.calm(button, text), SURE * 1000);
        button.before = text;
        return undefined;
      }
      clearTimeout(button.calm);
      ConsolePage.calm(button, button.before);
      return act();
    });
  }

  static calm(button, text) {
    button.classList.remove("sure");
    button.textContent = text;
  }

  key(event) {
    const isTyping = event.target.matches("input:not([type=checkbox]):not([type=range]), select");
    // a key that is held down asks once
    const ask = (what) => event.repeat || this.send({ do: what, who: "all" });
    if (event.key === "Escape") ask("emergency");
    else if (event.key === " " && !isTyping) {
      ask("land");
      // a button that still has the focus must not be pressed as well: hold would end the landing
      if (document.activeElement) document.activeElement.blur();
    } else return;
    event.preventDefault();
  }

  listen() {
    const stream = new EventSource("/events");
    stream.onmessage = (message) => this.show(JSON.parse(message.data));
    // a browser tries again by itself, but not where the server had no room for one more page
    stream.onerror = () => stream.readyState === EventSource.CLOSED && setTimeout(() => this.listen(), 1000 * AGAIN);
  }

  show(picture) {
    this.heard = this.now();
    const names = picture.drones.map((drone) => drone.name);
    // a console that has just begun knows no drones yet: those that it had stay
    const isOther = !this.flight || (names.length > 0 && names.join() !== this.flight.drones.map((drone) => drone.name).join());
    // the sender's time: what came late is drawn where it belongs; another sender or clock begins anew
    if (isOther || picture.time - this.origin < this.flight.end) this.build(picture, names);
    this.flight.add(picture.time - this.origin, picture);
    this.writeLog(picture);
    this.tell(picture);
    if (this.isDue || this.now() < this.rested) return;
    this.isDue = true;
    this.asked = this.now();
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.isDue = false;
    const time = this.flight.end;
    // a machine that draws slowly, without a graphics card, needs its processor for the flight
    const waited = this.now() - this.asked;
    this.rested = waited > SLOW ? this.now() + REST * waited : -Infinity;
    if (this.view) this.view.show(time);
    this.fillCards(time);
    if (this.now() - this.drawn < CURVES) return;
    this.drawn = this.now();
    this.plots.show([Math.max(0, time - SHOWN), Math.max(1, time)], true);
    this.timeline.paint();
    this.fillSliders();
  }

  tell(picture) {
    const { certificate, period } = picture.setup;
    const count = picture.drones.length;
    const text = certificate
      ? `${count} drone${count === 1 ? "" : "s"}, certificate ${certificate}, ${written(1 / period)} Hz`
      : "no controller has told what it flies: start one";
    // to write the same again would let the browser draw, and a screen reader read it again
    if (this.parts.subtitle.textContent !== text) this.parts.subtitle.textContent = text;
  }

  build(picture, names) {
    this.origin = picture.time - 0.01;
    this.drawn = this.rested = -Infinity;
    this.flight = new LiveFlight(picture.setup, names);
    if (this.view) this.view.close();
    for (const part of ["scene", "timeline", "plots", "cards"]) this.parts[part].replaceChildren();
    this.view = View3d.canDraw() && names.length ? new View3d(this.parts.scene, this.flight) : null;
    if (this.view) this.aimAt(this.view);
    else this.parts.scene.append(element("p", {}, names.length ? "This browser has no WebGL: the drones cannot be drawn." : "No drone is known yet."));
    this.plots = new Plots(this.parts.plots, this.flight, () => {}, QUANTITIES.filter(({ title }) => WATCHED.includes(title)));
    this.timeline = new Timeline(this.parts.timeline, this.flight, () => {}, SHOWN);
    this.cards = names.map((name, k) => this.card(name, k));
    this.parts.whose.replaceChildren(element("option", { value: "all" }, "all drones"), ...names.map((name) => element("option", { value: name }, name)));
    this.choose(0);
    this.looked = false;
  }

  card(name, k) {
    const mode = element("span", { class: "mode" });
    const lines = [element("p"), element("p"), element("p")];
    const button = (text, what, sure) => {
      const made = element("button", { type: "button", "data-what": what, ...(sure ? { "data-sure": "" } : {}) }, text);
      ConsolePage.guard(made, () => this.send({ do: what, who: name }));
      return made;
    };
    const buttons = element(
      "div",
      {},
      button("Take off", "takeoff", true), button("Land", "land"), button("Hold", "hold"), button("Hand over", "hand_over", true),
      button("Arm", "arm", true), button("Disarm", "disarm"), button("Emergency", "emergency", true),
    );
    const choose = element("button", { type: "button", "aria-label": `choose ${name}`, onclick: () => this.choose(k) }, name);
    const card = element("article", { class: "card", "aria-label": name }, element("h3", {}, element("i", { class: "dot", style: `background:${colourOf(k)}` }), choose, mode), ...lines, buttons);
    this.parts.cards.append(card);
    return { card, mode, lines };
  }

  choose(index) {
    this.chosen = index;
    this.cards.forEach(({ card }, k) => card.classList.toggle("chosen", k === index));
    const drone = this.flight.drones[index];
    this.parts.aimed.textContent = drone ? drone.name : "–";
  }

  fillCards(time) {
    this.flight.drones.forEach((drone, k) => {
      const { mode, lines } = this.cards[k];
      const ticks = drone.channel("tick");
      const value = (field) => ticks.at(field, time, LOST);
      const which = value("mode");
      mode.textContent = Number.isNaN(which) ? "no telemetry" : MODES[which] || String(which);
      mode.style.background = Number.isNaN(which) ? "#6b7280" : MODE_COLOURS[which] || "#000";
      const pose = drone.poseAt(time);
      const error = 100 * Math.hypot(value("error_x"), value("error_y"), value("error_z"));
      const age = drone.ages.pose;
      const old = element("b", age > LATE ? { class: "late" } : {}, Number.isFinite(age) ? `${written(1000 * age, 2)} ms` : "none");
      const proven = which === 2 ? (value("guaranteed") === 1 ? "guaranteed" : ["not guaranteed", ASSUMPTIONS[value("assumption")]].filter(Boolean).join(": ")) : "";
      lines[0].replaceChildren("z ", element("b", {}, pose ? `${(Math.round(100 * pose.position[2]) / 100 || 0).toFixed(2)} m` : "–"), "  error ", element("b", {}, which === 2 ? `${error.toFixed(1)} cm` : "–"), "  γ ", element("b", {}, written(value("gamma"))), "  ", proven);
      lines[1].replaceChildren("battery ", element("b", {}, `${written(drone.channel("battery").at("voltage", time, 10))} V`), "  pose age ", old);
      lines[2].replaceChildren("link ", ConsolePage.linkOf(drone));
    });
    const seen = this.flight.drones.filter((drone) => drone.channel("pose").length).length;
    if (!this.looked && this.view && seen && (seen === this.flight.drones.length || time > LATECOMERS)) {
      this.looked = true;
      this.view.paint();
      this.view.lookAtAll();
    }
  }

  /** What the node that speaks with a drone tells of it. */
  static linkOf({ link }) {
    if (!link || link.age > SILENT) return element("b", { class: "late" }, "not told of");
    return element("b", link.severity ? { class: "late" } : {}, link.text);
  }

  aimAt(view) {
    const canvas = view.renderer.domElement;
    let down = null;
    canvas.addEventListener("pointerdown", (event) => (down = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => {
      // a drag turns the view
      if (!this.parts.aim.checked || !down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
      const box = canvas.getBoundingClientRect();
      const place = view.floorAt((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
      if (!place) return;
      this.parts["goal-x"].value = place.x.toFixed(2);
      this.parts["goal-y"].value = place.y.toFixed(2);
      this.sendGoal();
    });
  }

  /** Send the chosen drone to where the fields say. */
  sendGoal() {
    const drone = this.flight && this.flight.drones[this.chosen];
    const position = ["goal-x", "goal-y", "height"].map((part) => this.parts[part].valueAsNumber);
    if (!drone) this.say("no drone is known yet", "refused");
    else this.send({ do: "goal", who: drone.name, position });
  }

  makeSliders() {
    this.sliders = TUNED.map(([name, title, low, high]) => {
      const range = element("input", { type: "range", min: Math.log(low), max: Math.log(high), step: "any", "aria-label": `${title}, slider` });
      const number = element("input", { type: "number", step: "any", id: `tune-${name}`, "aria-label": title });
      range.addEventListener("input", () => (number.value = Number(Math.exp(Number(range.value)).toPrecision(3))));
      // an emptied field asks for nothing, and soon shows again what is in force
      const send = () => number.value === "" || this.send({ do: "set", who: this.parts.whose.value, name, value: Number(number.value) });
      range.addEventListener("change", send);
      number.addEventListener("change", send);
      this.parts.sliders.append(element("label", {}, title, range, number));
      return { name, range, number };
    });
    this.parts.whose.addEventListener("change", () => this.fillSliders());
  }

  /** Show the values that are in force, but not where somebody is about to change one. */
  fillSliders() {
    const { setup } = this.flight;
    const whose = this.parts.whose.value;
    for (const { name, range, number } of this.sliders) {
      if ([range, number].includes(document.activeElement)) continue;
      const own = setup[`robots.${whose}.${name}`];
      const value = own === undefined ? setup[name] : own;
      if (!Number.isFinite(value)) continue;
      number.value = Number(value.toPrecision(4));
      range.value = Math.log(Math.max(value, 1e-9));
    }
  }

  async send(command) {
    this.sent += 1;
    this.say(`${command.do} ${command.who}…`, "");
    try {
      const answer = await fetch("/command", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(command) });
      const { done, text } = answer.ok ? await answer.json() : { done: false, text: await answer.text() };
      this.say(done ? `${command.do} ${command.who}: ${text || "done"}` : text, done ? "" : "refused");
    } catch (error) {
      this.say(`${command.do} ${command.who}: the console does not answer`, "refused");
    }
    // a value that was refused gives way to the one in force
    if (document.activeElement && document.activeElement.type === "range") document.activeElement.blur();
  }

  say(text, kind) {
    this.parts.said.textContent = text;
    this.parts.said.className = kind;
  }

  writeLog({ began, lines }) {
    // a console that starts again counts from its own beginning
    if (began !== this.began) this.line = 0;
    this.began = began;
    for (const { number, level, text } of lines) {
      if (number <= this.line) continue;
      this.line = number;
      const severity = level >= 40 ? "error" : level >= 30 ? "warning" : "info";
      this.parts.log.prepend(element("li", { class: severity }, text));
    }
    while (this.parts.log.childElementCount > 200) this.parts.log.lastChild.remove();
  }

  watch() {
    const silence = this.now() - this.heard;
    if (silence < LOST) return;
    this.parts.subtitle.textContent = Number.isFinite(silence) ? `nothing heard for ${Math.round(silence)} s: is the console running?` : "connecting…";
  }

  switchTheme() {
    switchTheme();
    if (!this.flight) return;
    this.plots.build();
    if (this.view) this.view.paint();
  }
}

window.console_ = new ConsolePage();
