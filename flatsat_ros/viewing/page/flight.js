// What was flown: channels of samples over time, one set for each drone.

/** Samples of one kind: a time, s, and a value for each field; rows are in the order of time. */
class Channel {
  constructor(fields, times, columns) {
    this.fields = fields;
    this.times = times;
    this.columns = columns;
  }

  get length() {
    return this.times.length;
  }

  /** Index of the last sample at or before a time; -1 before the first one. */
  indexAt(time) {
    let low = 0;
    let high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  column(field) {
    const index = this.fields.indexOf(field);
    return index < 0 ? null : this.columns[index];
  }

  /** Value of a field at a time, the last one that came; NaN when there is none, or none for too long. */
  at(field, time, stale = 1.0) {
    const column = this.column(field);
    const index = this.indexAt(time);
    if (!column || index < 0 || time - this.times[index] > stale) return NaN;
    return column[index];
  }
}

const BELOW = 0.03; // m: a reference so far below all places where the drone was leads into the floor
const EMPTY = new Channel([], new Float32Array(0), []);

/** One drone: its name and its channels: pose, tick, command, battery. */
class Drone {
  constructor(name, channels) {
    this.name = name;
    this.channels = channels;
  }

  channel(kind) {
    return this.channels[kind] || EMPTY;
  }

  /** Position, m, and orientation at a time, between the two poses around it; null where there is none. */
  poseAt(time) {
    const poses = this.channel("pose");
    const index = poses.indexAt(time);
    if (index < 0 || time - poses.times[index] > 1.0) return null;
    const next = Math.min(index + 1, poses.length - 1);
    const span = poses.times[next] - poses.times[index];
    const share = span > 0 && span < 1.0 ? Math.min(1, (time - poses.times[index]) / span) : 0;
    const value = (k) => poses.columns[k][index] + share * (poses.columns[k][next] - poses.columns[k][index]);
    const turn = [3, 4, 5, 6].map((k) => poses.columns[k][index]);
    return { position: [value(0), value(1), value(2)], orientation: turn.every(Number.isFinite) ? turn : [0, 0, 0, 1] };
  }

  /** Where the reference is at a time, m: the position less its error; null where that is not known. */
  referenceAt(time) {
    const pose = this.poseAt(time);
    const ticks = this.channel("tick");
    if (!pose || ticks.at("mode", time) !== 2) return null;
    const place = ["error_x", "error_y", "error_z"].map((field, k) => pose.position[k] - ticks.at(field, time));
    return place.every(Number.isFinite) ? place : null;
  }

  /**
   * Tells of each tick, by its index, whether its reference lies below the floor: at the end of a landing it goes on
   * sinking, and what is told of errors then says nothing of the flight (figures.py leaves it out, too).
   */
  sinking() {
    const ticks = this.channel("tick");
    const errors = ticks.column("error_z") || [];
    const heights = this.channel("pose").column("z") || [];
    const lowest = heights.reduce((low, height) => (height < low ? height : low), Infinity);
    return (index) => {
      if (!(errors[index] > BELOW)) return false;
      const pose = this.poseAt(ticks.times[index]);
      return pose !== null && pose.position[2] - errors[index] < lowest - BELOW;
    };
  }

  /** Radii of the tube at a time, m, horizontal and vertical; null where none is certified. */
  tubeAt(time) {
    const radii = ["tube", "tube_z"].map((field) => this.channel("tick").at(field, time));
    return radii.every((radius) => radius > 0) ? radii : null;
  }

  /** Why nothing is guaranteed at a time; empty where something is, or where that is not known. */
  doubtAt(time) {
    const ticks = this.channel("tick");
    return ticks.at("mode", time) === 2 && ticks.at("guaranteed", time) === 0 ? ASSUMPTIONS[ticks.at("assumption", time)] || "" : "";
  }
}

/** All drones, what happened to them, and what is known of the controller. */
class Flight {
  constructor(header, drones) {
    Object.assign(this, header);
    this.drones = drones;
  }

  get end() {
    return this.duration;
  }
}

/** Read a flight out of the bytes that `page.py` writes: length of the header, header, columns of float32. */
function decodeFlight(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let offset = 4 + size + ((4 - (size % 4)) % 4);
  const take = (count) => {
    const values = new Float32Array(buffer, offset, count);
    offset += 4 * count;
    return values;
  };
  const drones = header.drones.map(({ name, channels }) => {
    const read = {};
    for (const { kind, fields, count } of channels) {
      const times = take(count);
      read[kind] = new Channel(fields, times, fields.map(() => take(count)));
    }
    return new Drone(name, read);
  });
  return new Flight(header, drones);
}

/** Unpack the flight that stands in the page itself: gzip in base64. */
async function embeddedFlight(text) {
  const packed = Uint8Array.from(atob(text.trim()), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return decodeFlight(await new Response(stream).arrayBuffer());
}
