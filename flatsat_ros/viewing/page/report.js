// The page of a recorded flight: what is shown follows one time, which plays, pauses and is dragged.

class Report {
  constructor(flight) {
    this.flight = flight;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.chosen = flight.drones.map(() => true);
    const find = (id) => document.getElementById(id);
    document.title = `${flight.title} – flight report`;
    find("title").textContent = flight.title;
    find("subtitle").textContent = `${flight.drones.length} drone${flight.drones.length === 1 ? "" : "s"}, ${clock(flight.end)} min`;
    const seek = (time) => this.seek(time);
    this.view = View3d.canDraw() ? new View3d(find("scene"), flight) : null;
    if (!this.view) find("scene").append(element("p", {}, "This browser has no WebGL: the drones cannot be drawn."));
    this.plots = new Plots(find("plots"), flight, seek);
    this.timeline = new Timeline(find("timeline"), flight, seek);
    this.tables = new Tables(find("tables"), flight, seek);
    this.clock = find("clock");
    this.slider = find("slider");
    Object.assign(this.slider, { min: 0, max: flight.end, step: 0.01, value: 0 });
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    this.button = find("play");
    this.button.addEventListener("click", () => this.play(!this.playing));
    find("speed").addEventListener("change", (event) => (this.speed = Number(event.target.value)));
    find("look").addEventListener("click", () => this.view && this.view.lookAtAll());
    find("theme").addEventListener("click", () => this.switchTheme());
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.repaint());
    this.chooser(find("drones"));
    document.addEventListener("keydown", (event) => this.key(event));
    // report.html#12.5 opens at 12.5 s
    this.seek(Number(window.location.hash.slice(1)) || 0);
  }

  chooser(host) {
    this.flight.drones.forEach((drone, k) => {
      const box = element("input", { type: "checkbox", checked: "", onchange: (event) => this.choose(k, event.target.checked) });
      host.append(element("label", {}, box, element("i", { class: "dot", style: `background:${colourOf(k)}` }), drone.name));
    });
  }

  choose(index, shown) {
    this.chosen[index] = shown;
    this.plots.choose(this.chosen);
    if (this.view) this.view.choose(this.chosen);
  }

  key(event) {
    if (event.target.matches("input:not([type=range]), select, button, [role=tabpanel]")) return;
    if (event.key === " ") this.play(!this.playing);
    else if (event.key === "ArrowLeft") this.seek(this.time - (event.shiftKey ? 1 : 0.1));
    else if (event.key === "ArrowRight") this.seek(this.time + (event.shiftKey ? 1 : 0.1));
    else return;
    event.preventDefault();
  }

  play(playing) {
    this.playing = playing;
    this.button.textContent = playing ? "Pause" : "Play";
    if (!playing) return;
    if (this.time >= this.flight.end) this.seek(0);
    let before = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      this.seek(this.time + ((now - before) / 1000) * this.speed);
      before = now;
      if (this.time >= this.flight.end) this.play(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  seek(time) {
    this.time = Math.max(0, Math.min(this.flight.end, time));
    this.clock.textContent = clock(this.time);
    this.slider.value = this.time;
    if (this.view) this.view.show(this.time);
    this.timeline.mark(this.time);
    this.plots.mark(this.time);
  }

  switchTheme() {
    switchTheme();
    this.repaint();
  }

  repaint() {
    this.plots.build();
    this.plots.choose(this.chosen);
    this.timeline.paint();
    if (this.view) this.view.paint();
    this.seek(this.time);
  }
}

embeddedFlight(document.getElementById("flight").textContent).then(
  (flight) => {
    window.report = new Report(flight);
    document.body.dataset.ready = "yes";
  },
  (error) => {
    document.getElementById("subtitle").textContent = `The flight in this page cannot be read: ${error}`;
  },
);
