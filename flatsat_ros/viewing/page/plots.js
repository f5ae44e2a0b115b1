// Quantities over time, one plot each, with one cursor and one span of time for all.

const DEGREES = 180 / Math.PI;
const SQUARED = (row) => Math.hypot(...row);

/**
 * What is drawn: title, unit, channel, fields, how a row of fields becomes a value, whether only in flight, whether only
 * while the reference is above the floor, limits from the setup, and for how long a value counts, s, if not for 0.25.
 */
const QUANTITIES = [
  { title: "Horizontal error", unit: "cm", kind: "tick", fields: ["error_x", "error_y"], value: (row) => 100 * SQUARED(row), flying: true, above: true, limits: (s) => [100 * s.tube_m] },
  { title: "Vertical error", unit: "cm", kind: "tick", fields: ["error_z"], value: ([a]) => 100 * a, flying: true, above: true, limits: (s) => [-100 * s.tube_z_m, 100 * s.tube_z_m] },
  { title: "V / ε", unit: "", kind: "tick", fields: ["V/eps"], flying: true, above: true, limits: () => [1] },
  { title: "Gain γ", unit: "", kind: "tick", fields: ["gamma"], limits: (s) => [s.gain_max] },
  { title: "Applied gain k", unit: "", kind: "tick", fields: ["k"], flying: true },
  { title: "Thrust T", unit: "m/s²", kind: "tick", fields: ["T"], limits: (s) => [s.thrust_min, s.thrust_max] },
  { title: "Roll φ", unit: "°", kind: "tick", fields: ["phi"], value: ([a]) => DEGREES * a, limits: (s) => [-DEGREES * s.tilt_max, DEGREES * s.tilt_max] },
  { title: "Pitch θ", unit: "°", kind: "tick", fields: ["theta"], value: ([a]) => DEGREES * a, limits: (s) => [-DEGREES * s.tilt_max, DEGREES * s.tilt_max] },
  { title: "Height z", unit: "m", kind: "pose", fields: ["z"] },
  { title: "Compensated disturbance", unit: "m/s²", kind: "tick", fields: ["d_x", "d_y", "d_z"], value: SQUARED },
  { title: "Thrust scale", unit: "", kind: "tick", fields: ["thrust_scale"], limits: () => [1] },
  { title: "Battery", unit: "V", kind: "battery", fields: ["voltage"], lasts: 10 },
  { title: "Commanded roll", unit: "°", kind: "command", fields: ["roll"], only: "tick" },
  { title: "Commanded pitch", unit: "°", kind: "command", fields: ["pitch"], only: "tick" },
  { title: "Commanded thrust", unit: "PWM", kind: "command", fields: ["thrust"], only: "tick" },
  { title: "Tick time", unit: "µs", kind: "tick", fields: ["tick_us"] },
];

const POINTS = 3000; // of one curve, over the span that is shown

/** Tell whether a flight has anything of a quantity; `only` is for those that stand in for a channel that is missing. */
function isThere(flight, { kind, fields, only }) {
  const has = (drone) => drone.channel(kind).length > 0 && fields.every((field) => drone.channel(kind).fields.includes(field));
  return flight.drones.some((drone) => has(drone) && !(only && drone.channel(only).length));
}

/** Values of a quantity on a grid of times; of the samples between two times the one that stands out most. */
function sampled(drone, quantity, times) {
  const channel = drone.channel(quantity.kind);
  const columns = quantity.fields.map((field) => channel.column(field));
  const values = new Array(times.length).fill(null);
  if (!channel.length || columns.some((column) => !column)) return values;
  const modes = quantity.flying ? channel.column("mode") : null;
  const isSinking = quantity.above ? drone.sinking() : () => false;
  const value = quantity.value || (([a]) => a);
  const step = times.length > 1 ? times[1] - times[0] : 0;
  let index = Math.max(0, channel.indexAt(times[0]));
  times.forEach((time, k) => {
    let found = null;
    for (let first = true; index < channel.length && channel.times[index] <= time; index += 1, first = false) {
      if ((modes && modes[index] !== 2) || isSinking(index)) continue;
      const one = value(columns.map((column) => column[index]));
      if (Number.isFinite(one) && (found === null || Math.abs(one) > Math.abs(found))) found = one;
    }
    const isFresh = index > 0 && time - channel.times[index - 1] < Math.max(quantity.lasts || 0.25, step) && !(modes && modes[index - 1] !== 2) && !isSinking(index - 1);
    if (found === null && k > 0 && isFresh) found = values[k - 1];
    values[k] = found;
  });
  return values;
}

class Plots {
  constructor(host, flight, onCursor, quantities = QUANTITIES.filter((quantity) => isThere(flight, quantity))) {
    this.host = host;
    this.flight = flight;
    this.onCursor = onCursor;
    this.chosen = flight.drones.map(() => true);
    this.span = [0, flight.end];
    this.plots = [];
    this.quantities = quantities;
    this.build();
    new ResizeObserver(() => this.resize()).observe(host);
  }

  build() {
    this.plots.forEach((plot) => plot.destroy());
    this.host.replaceChildren();
    this.plots = this.quantities.map((quantity) => this.plot(quantity));
    this.refill();
  }

  plot(quantity) {
    const { drones, setup } = this.flight;
    const limits = (quantity.limits ? quantity.limits(setup) : []).filter(Number.isFinite);
    const ink = style("--ink");
    const axis = { stroke: style("--quiet"), grid: { stroke: style("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const host = element("figure", { class: "plot" });
    const heading = element("figcaption", {}, quantity.title, quantity.unit ? element("small", {}, ` ${quantity.unit}`) : "");
    const reading = element("output", { class: "reading" });
    heading.append(reading);
    host.append(heading);
    this.host.append(host);
    const plot = new vendor.uPlot(
      {
        width: Math.max(200, host.clientWidth),
        height: 130,
        legend: { show: false },
        cursor: { drag: { x: true, y: false }, points: { size: 5 }, sync: { key: "flight" } },
        scales: { x: { time: false }, y: { range: (_, low, high) => Plots.range(low, high, limits) } },
        axes: [{ ...axis, size: 22, values: (_, ticks) => ticks.map((t) => `${t} s`) }, { ...axis, size: 54, space: 20, values: (_, ticks) => ticks.map(Plots.tick) }],  // so that two numbers find room
        series: [
          {},
          ...drones.map((drone, k) => ({ label: drone.name, stroke: colourOf(k), width: 1.4, dash: dashOf(k), spanGaps: false, points: { show: false } })),
        ],
        hooks: {
          setCursor: [(one) => this.read(one, reading)],
          setSelect: [(one) => this.select(one)],
          draw: [(one) => Plots.drawLimits(one, limits, ink)],
        },
      },
      [[0], ...drones.map(() => [null])],
      host,
    );
    plot.over.addEventListener("click", () => {
      if (plot.cursor.idx !== null) this.onCursor(plot.posToVal(plot.cursor.left, "x"));
    });
    plot.over.addEventListener("dblclick", () => this.show([0, this.flight.end]));
    return plot;
  }

  /** A number beside an axis, as short as it can be: all axes have the same room, so that times stand below each other. */
  static tick(value) {
    return Math.abs(value) < 1e5 ? written(value, 4) : Number(value.toPrecision(4)).toExponential();
  }

  static range(low, high, limits) {
    const values = [low, high, ...limits.filter((limit) => Math.abs(limit) < 20 * Math.max(Math.abs(low), Math.abs(high), 1e-9))].filter(Number.isFinite);
    if (!values.length) return [0, 1];
    const bottom = Math.min(...values);
    const top = Math.max(...values);
    // of curves that are level, nobody wants to see the rounding
    const room = top - bottom > 1e-6 ? 0.08 * (top - bottom) : Math.max(0.1 * Math.abs(top), 0.01);
    return [bottom - room, top + room];
  }

  static drawLimits(plot, limits, ink) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.strokeStyle = ink;
    ctx.globalAlpha = 0.55;
    ctx.setLineDash([5, 5]);
    for (const limit of limits) {
      const y = plot.valToPos(limit, "y", true);
      if (y < bbox.top || y > bbox.top + bbox.height) continue;
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
    }
    ctx.restore();
  }

  read(plot, reading) {
    const index = plot.cursor.idx;
    reading.replaceChildren();
    if (index === null || index === undefined) return;
    this.flight.drones.forEach((drone, k) => {
      const value = this.chosen[k] ? plot.data[k + 1][index] : null;
      if (value === null || value === undefined || reading.childElementCount >= 6) return;
      reading.append(element("span", {}, element("i", { class: "dot", style: `background:${colourOf(k)}` }), written(value)));
    });
  }

  select(plot) {
    const { left, width } = plot.select;
    if (width < 8) return;
    const span = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.show(span);
  }

  show(span, onlySeen = false) {
    this.span = span;
    this.refill(onlySeen);
  }

  choose(chosen) {
    this.chosen = chosen;
    this.plots.forEach((plot) => chosen.forEach((shown, k) => plot.setSeries(k + 1, { show: shown })));
  }

  /** Draw the curves anew, all or only those that are on the screen now. */
  refill(onlySeen = false) {
    const [begin, end] = this.span;
    const count = Math.max(2, Math.min(POINTS, Math.ceil((end - begin) * 100)));
    const times = Array.from({ length: count }, (_, k) => begin + ((end - begin) * k) / (count - 1));
    this.plots.forEach((plot, k) => {
      const { top, bottom } = plot.root.getBoundingClientRect();
      if (onlySeen && (bottom < 0 || top > window.innerHeight)) return;
      const rows = this.flight.drones.map((drone) => sampled(drone, this.quantities[k], times));
      plot.setData([times, ...rows], false);
      plot.setScale("x", { min: begin, max: end });
    });
  }

  /** Put the line of the present at a time. */
  mark(time) {
    for (const plot of this.plots) {
      const left = plot.valToPos(time, "x");
      if (!plot.marker) {
        plot.marker = element("div", { class: "now" });
        plot.over.append(plot.marker);
      }
      plot.marker.style.transform = `translateX(${left}px)`;
      plot.marker.hidden = !(left >= 0 && left <= plot.over.clientWidth);
    }
  }

  resize() {
    const width = this.host.clientWidth;
    this.plots.forEach((plot) => {
      const room = Math.max(200, plot.root.parentElement.clientWidth);
      if (width && Math.abs(plot.width - room) > 1) plot.setSize({ width: room, height: 130 });
    });
  }
}
