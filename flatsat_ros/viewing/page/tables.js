// Figures of each drone, what happened, what the controller was set to, and the samples as files.

class Tables {
  constructor(host, flight, onSeek) {
    this.flight = flight;
    this.onSeek = onSeek;
    const pages = [
      ["Figures", this.figures()],
      [`Events (${flight.events.length})`, this.events()],
      ["Set-up", this.setup()],
      ["Data", this.data()],
    ];
    const bar = element("div", { role: "tablist", class: "tabs" });
    const bodies = pages.map(([title, body], k) => {
      const tab = element("button", { role: "tab", type: "button", id: `tab${k}`, "aria-controls": `panel${k}`, onclick: () => select(k) }, title);
      const panel = element("div", { role: "tabpanel", id: `panel${k}`, "aria-labelledby": `tab${k}`, tabindex: "0" }, body);
      bar.append(tab);
      return panel;
    });
    const select = (chosen) => {
      [...bar.children].forEach((tab, k) => tab.setAttribute("aria-selected", String(k === chosen)));
      bodies.forEach((body, k) => (body.hidden = k !== chosen));
    };
    host.append(bar, ...bodies);
    select(0);
  }

  figures() {
    const { columns, rows, lines } = this.flight.figures;
    const head = element("tr", {}, element("th", { scope: "col" }, "drone"));
    columns.forEach(({ name, unit }) => head.append(element("th", { scope: "col" }, name, unit ? element("small", {}, ` ${unit}`) : "")));
    const body = rows.map(({ drone, values }, k) => {
      const name = element("th", { scope: "row", title: drone }, element("i", { class: "dot", style: `background:${colourOf(k)}` }), drone);
      return element("tr", {}, name, ...values.map((value) => element("td", {}, written(value))));
    });
    const table = element("div", { class: "wide" }, element("table", {}, element("thead", {}, head), element("tbody", {}, ...body)));
    return element("div", {}, table, ...lines.map((line) => element("p", {}, line)));
  }

  events() {
    const list = element("ol", { class: "events" });
    for (const { time, drone, severity, text } of this.flight.events) {
      const go = element("button", { type: "button", onclick: () => this.onSeek(time) }, clock(time));
      list.append(element("li", { class: severity }, go, drone ? element("b", {}, `${drone} `) : "", text));
    }
    return this.flight.events.length ? list : element("p", {}, "Nothing was recorded: no changes of modes, no messages of the log.");
  }

  setup() {
    const list = element("dl");
    for (const [name, value] of Object.entries(this.flight.setup)) {
      list.append(element("dt", {}, name), element("dd", {}, Array.isArray(value) ? value.map((one) => written(one, 6)).join(", ") : written(value, 6)));
    }
    const notes = this.flight.notes.map((note) => element("p", {}, note));
    return element("div", {}, ...notes, list.childElementCount ? list : element("p", {}, "The recording does not say how the controller was set up."));
  }

  data() {
    const list = element("ul", { class: "files" });
    for (const drone of this.flight.drones) {
      for (const [kind, channel] of Object.entries(drone.channels)) {
        if (!channel.length) continue;
        const name = `${drone.name.replace(/[^\w.-]+/g, "_")}_${kind}.csv`;
        const save = element("button", { type: "button", onclick: () => Tables.save(name, channel) }, name);
        list.append(element("li", {}, save, ` ${channel.length} rows: time_s, ${channel.fields.join(", ")}`));
      }
    }
    return list;
  }

  /** A number as a spreadsheet reads it, with the digits that it has; nothing where there is none. */
  static cell(value) {
    return Number.isFinite(value) ? String(Number(value.toPrecision(7))) : "";
  }

  static save(name, channel) {
    const lines = [["time_s", ...channel.fields].join(",")];
    for (let k = 0; k < channel.length; k += 1) {
      lines.push([channel.times[k], ...channel.columns.map((column) => column[k])].map(Tables.cell).join(","));
    }
    const address = URL.createObjectURL(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }));
    element("a", { href: address, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(address), 1000);
  }
}
