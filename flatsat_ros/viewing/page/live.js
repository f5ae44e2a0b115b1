// A flight that is going on: the same drones and channels, which grow at their end.

const KEPT = 120; // s
const TICK_FIELDS = [
  "V", "V/eps", "gamma", "k", "T", "phi", "theta", "v_x", "v_y", "v_z", "error_x", "error_y", "error_z",
  "error_vx", "error_vy", "error_vz", "mode", "tick_us", "set", "kappa", "guaranteed", "d_x", "d_y", "d_z", "thrust_scale",
  "tube", "tube_z", "assumption", "events",
];
const CHANNELS = {
  pose: ["x", "y", "z", "qx", "qy", "qz", "qw"],
  telemetry: TICK_FIELDS,
  battery: ["voltage"],
};

class LiveChannel extends Channel {
  constructor(fields) {
    super(fields, [], fields.map(() => []));
  }

  add(time, values) {
    if (values.length !== this.fields.length || (this.length && time <= this.times[this.length - 1])) return;
    this.times.push(time);
    values.forEach((value, k) => this.columns[k].push(value === null ? NaN : value));
    // now and then, not at every sample: it moves all of them
    if (this.length > 40 && this.times[0] < time - 1.25 * KEPT) {
      const old = this.indexAt(time - KEPT);
      for (const column of [this.times, ...this.columns]) column.splice(0, old);
    }
  }
}

/** All that the console has told so far. */
class LiveFlight extends Flight {
  constructor(setup, names) {
    super({ title: "live", setup, events: [], notes: [], duration: 0 }, []);
    this.isLive = true;
    this.drones = names.map((name) => {
      const drone = new Drone(name, { pose: new LiveChannel(CHANNELS.pose), tick: new LiveChannel(CHANNELS.telemetry), battery: new LiveChannel(CHANNELS.battery) });
      drone.ages = {};
      return drone;
    });
  }

  /** Take in a picture, at a time of this page's own, s. */
  add(time, picture) {
    this.setup = picture.setup;
    this.duration = time;
    this.drones.forEach((drone, k) => {
      const told = picture.drones[k] || {};
      drone.link = told.link;
      for (const [kind, channel] of [["pose", "pose"], ["telemetry", "tick"], ["battery", "battery"]]) {
        const news = told[kind];
        drone.ages[kind] = news ? news.age : Infinity;
        if (news && news.values.length) drone.channels[channel].add(time - news.age, news.values);
      }
    });
  }
}
