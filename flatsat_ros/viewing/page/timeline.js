// Who was in which mode and who was guaranteed when, over the whole flight; a click goes there.

class Timeline {
  /** With a number of seconds it shows the last ones of a flight that goes on. */
  constructor(host, flight, onSeek, seconds = Infinity) {
    this.seconds = seconds;
    this.host = host;
    this.flight = flight;
    this.onSeek = onSeek;
    this.time = 0;
    this.canvas = element("canvas", { role: "img", "aria-label": "flight modes and guarantee of each drone over time" });
    this.marker = element("div", { class: "now" });
    this.stage = element("div", { class: "strips" }, this.canvas, this.marker);
    this.doubts = element("p", { class: "doubts" });
    host.append(this.stage, this.legend(), this.doubts);
    this.stage.addEventListener("pointerdown", (event) => {
      this.stage.setPointerCapture(event.pointerId);
      this.seek(event);
    });
    this.stage.addEventListener("pointermove", (event) => {
      if (event.buttons) this.seek(event);
    });
    new ResizeObserver(() => this.paint()).observe(this.stage);
  }

  legend() {
    const isLive = Number.isFinite(this.seconds);
    const used = MODES.filter((_, mode) => isLive || this.flight.drones.some((drone) => (drone.channel("tick").column("mode") || []).includes(mode)));
    const keys = used.map((name) => element("span", {}, element("i", { style: `background:${MODE_COLOURS[MODES.indexOf(name)]}` }), name));
    return element("div", { class: "legend" }, ...keys, element("span", {}, element("i", { class: "proven" }), "guaranteed"), element("span", {}, element("i", { class: "doubt" }), "an assumption does not hold"));
  }

  /** As much of a name as fits into a width, px. */
  static fitted(pen, name, width) {
    let text = name;
    for (let most = name.length; most > 1 && pen.measureText(text).width > width; most -= 1) text = shortened(name, most - 1);
    return text;
  }

  get names() {
    return Math.min(110, Math.max(40, 0.16 * this.stage.clientWidth));
  }

  /** The time at the left edge, s. */
  get begin() {
    return Math.max(0, this.flight.end - this.seconds);
  }

  seek(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - this.names) / (box.width - this.names);
    this.onSeek(this.begin + Math.max(0, Math.min(1, share)) * (this.flight.end - this.begin));
  }

  mark(time) {
    this.time = time;
    const doubts = this.flight.drones.map((drone) => [drone.name, drone.doubtAt(time)]).filter(([, doubt]) => doubt);
    this.doubts.textContent = doubts.length ? `Not guaranteed: ${doubts.map((words) => words.join(", ")).join("; ")}` : "";
    const width = this.stage.clientWidth - this.names;
    this.marker.hidden = Number.isFinite(this.seconds);
    this.marker.style.transform = `translateX(${this.names + (width * time) / this.flight.end}px)`;
  }

  paint() {
    const { drones, events, end } = this.flight;
    const row = drones.length > 20 ? 9 : drones.length > 8 ? 13 : 18;
    const width = this.stage.clientWidth;
    const height = row * drones.length + 14;
    const ratio = window.devicePixelRatio || 1;
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = `${Math.min(12, row - 2)}px system-ui, sans-serif`;
    pen.textBaseline = "middle";
    const left = this.names;
    const { begin } = this;
    // whole pixels: two strips that meet inside of one would let the paper shine through
    const toX = (time) => Math.round(left + ((width - left) * Math.max(0, time - begin)) / (end - begin || 1));
    drones.forEach((drone, k) => {
      const top = row * k;
      pen.fillStyle = style("--ink");
      pen.fillText(Timeline.fitted(pen, drone.name, left - 6), 0, top + row / 2, left - 6);
      this.strip(pen, drone.channel("tick"), toX, top, row);
    });
    for (const event of events) {
      pen.fillStyle = event.severity === "error" ? "#d55e00" : event.severity === "warning" ? "#e69f00" : style("--quiet");
      pen.fillRect(toX(event.time) - 1, row * drones.length + 2, 2, 10);
    }
    this.mark(this.time);
  }

  strip(pen, ticks, toX, top, row) {
    const modes = ticks.column("mode");
    const proven = ticks.column("guaranteed");
    const broken = ticks.column("assumption");
    if (!modes) return;
    let begin = Math.max(0, ticks.indexAt(this.begin));
    for (let k = begin + 1; k <= ticks.length; k += 1) {
      const isEnd = k === ticks.length;
      if (!isEnd && modes[k] === modes[begin] && (proven ? proven[k] === proven[begin] : true) && (broken ? broken[k] === broken[begin] : true)) continue;
      const from = toX(ticks.times[begin]);
      const to = toX(ticks.times[isEnd ? k - 1 : k]);
      pen.fillStyle = MODE_COLOURS[modes[begin]] || "#000";
      pen.fillRect(from, top + 1, Math.max(1, to - from), row - 2);
      if (proven && proven[begin] === 1) {
        pen.fillStyle = "#fff";
        pen.fillRect(from, top + row - 5, Math.max(1, to - from), 2);
      } else if (broken && broken[begin] > 0 && modes[begin] === 2) {
        const why = ASSUMPTIONS[broken[begin]] || "";
        pen.fillStyle = "#f0e442";
        pen.fillRect(from, top + row - 5, Math.max(1, to - from), 3);
        pen.fillStyle = "#fff";
        if (pen.measureText(why).width < to - from - 6) pen.fillText(why, from + 3, top + (row - 4) / 2);
      }
      begin = k;
    }
  }
}
