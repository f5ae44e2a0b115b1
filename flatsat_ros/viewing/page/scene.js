// The room in three dimensions: drones with attitude, trails, references, tubes, the box for references, the floor.

const ARM = 0.046; // m, from the centre of a Crazyflie to a rotor
const SHOWN_LARGER = 2.0; // drones are drawn larger than they are, or nobody would see them from across a room
const TRAIL = 8.0; // s
const TRAIL_POINTS = 240;
const FAR = 1000; // m: what is further away is no room, but a pose gone wrong
const RISE = 1.2; // m, above the floor, that is in the picture of drones that fly now
const LONG = 20; // characters of a label, at most
const MANY = 12; // drones, from which on labels are smaller
const LINES = 200; // of the grid, at most

class View3d {
  constructor(host, flight) {
    this.host = host;
    this.flight = flight;
    this.chosen = flight.drones.map(() => true);
    this.renderer = new vendor.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    const canvas = this.renderer.domElement;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "the drones in space, with trails, references and tubes");
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    host.append(canvas);
    this.scene = new vendor.Scene();
    this.camera = new vendor.PerspectiveCamera(42, 1, 0.02, 500);
    this.camera.up.set(0, 0, 1);
    this.controls = new vendor.OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.scene.add(new vendor.AmbientLight(0xffffff, 1.6));
    const sun = new vendor.DirectionalLight(0xffffff, 1.8);
    sun.position.set(3, -4, 8);
    this.scene.add(sun);
    this.models = flight.drones.map((drone, k) => this.model(drone, k));
    this.surroundings = new vendor.Group();
    this.scene.add(this.surroundings);
    this.paint();
    this.resize();
    this.lookAtAll();
    new ResizeObserver(() => this.resize()).observe(host);
  }

  /** Tell whether this browser draws three dimensions; asked once: each question takes one of its few contexts. */
  static canDraw() {
    View3d.isAble ??= Boolean(document.createElement("canvas").getContext("webgl2"));
    return View3d.isAble;
  }

  /** Where the floor is seen at a place of the picture, 0 to 1 from the left and from above; null for the sky. */
  floorAt(right, down) {
    const ray = new vendor.Vector3(2 * right - 1, 1 - 2 * down, 0.5).unproject(this.camera).sub(this.camera.position);
    const floor = Number.isFinite(this.flight.setup.floor) ? this.flight.setup.floor : 0;
    const share = (floor - this.camera.position.z) / ray.z;
    return share > 0 && Number.isFinite(share) ? this.camera.position.clone().addScaledVector(ray, share) : null;
  }

  model(drone, k) {
    const colour = new vendor.Color(colourOf(k));
    const body = new vendor.Group();
    const frame = new vendor.MeshStandardMaterial({ color: 0x444a50, roughness: 0.7 });
    const disc = new vendor.MeshStandardMaterial({ color: colour, transparent: true, opacity: 0.75, side: vendor.DoubleSide });
    const size = SHOWN_LARGER * ARM;
    for (let arm = 0; arm < 4; arm += 1) {
      const angle = Math.PI / 4 + (arm * Math.PI) / 2;
      const beam = new vendor.Mesh(new vendor.BoxGeometry(size, 0.1 * size, 0.08 * size), frame);
      beam.position.set((Math.cos(angle) * size) / 2, (Math.sin(angle) * size) / 2, 0);
      beam.rotation.z = angle;
      const rotor = new vendor.Mesh(new vendor.CircleGeometry(0.5 * size, 20), disc);
      rotor.position.set(Math.cos(angle) * size, Math.sin(angle) * size, 0.12 * size);
      body.add(beam, rotor);
    }
    const nose = new vendor.Mesh(new vendor.ConeGeometry(0.16 * size, 0.6 * size, 12), new vendor.MeshStandardMaterial({ color: colour }));
    nose.rotation.z = -Math.PI / 2; // forward is x
    nose.position.x = 0.75 * size;
    body.add(nose);
    const trail = new vendor.Line(
      new vendor.BufferGeometry().setAttribute("position", new vendor.BufferAttribute(new Float32Array(3 * TRAIL_POINTS), 3)),
      new vendor.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.8 }),
    );
    trail.frustumCulled = false;
    const reference = new vendor.Mesh(
      new vendor.SphereGeometry(0.018, 12, 8),
      new vendor.MeshBasicMaterial({ color: colour, wireframe: true }),
    );
    const tube = new vendor.Mesh(
      new vendor.SphereGeometry(1, 24, 16),
      new vendor.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.2, depthWrite: false }),
    );
    const stick = new vendor.Line(
      new vendor.BufferGeometry().setAttribute("position", new vendor.BufferAttribute(new Float32Array(6), 3)),
      new vendor.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.35 }),
    );
    stick.frustumCulled = false;
    const group = new vendor.Group();
    group.add(body, trail, reference, tube, stick);
    this.scene.add(group);
    return { group, body, label: null, trail, reference, tube, stick };
  }

  static label(whole, colour) {
    const text = shortened(whole, LONG);
    const canvas = document.createElement("canvas");
    const pen = canvas.getContext("2d");
    const font = "600 44px system-ui, sans-serif";
    pen.font = font;
    canvas.width = Math.ceil(pen.measureText(text).width) + 24;
    canvas.height = 60;
    pen.font = font;
    pen.fillStyle = colour;
    pen.textBaseline = "middle";
    pen.fillText(text, 12, 32);
    const texture = new vendor.CanvasTexture(canvas);
    texture.colorSpace = "srgb";
    const sprite = new vendor.Sprite(new vendor.SpriteMaterial({ map: texture, depthTest: false, sizeAttenuation: false }));
    sprite.scale.set((0.032 * canvas.width) / canvas.height, 0.032, 1);
    sprite.center.set(0.5, -0.9);
    return sprite;
  }

  /** Box around everything that was flown, m. */
  extent() {
    const box = new vendor.Box3();
    const point = new vendor.Vector3();
    for (const drone of this.flight.drones) {
      const poses = drone.channel("pose");
      const step = Math.max(1, Math.floor(poses.length / 500));
      for (let k = 0; k < poses.length; k += step) {
        point.set(poses.columns[0][k], poses.columns[1][k], poses.columns[2][k]);
        if (point.length() < FAR) box.expandByPoint(point);
      }
    }
    if (box.isEmpty()) return new vendor.Box3(new vendor.Vector3(-1, -1, 0), new vendor.Vector3(1, 1, 1));
    if (this.flight.isLive) {
      // drones that stand on the floor will rise, and others land
      const { floor } = this.flight.setup;
      const low = Number.isFinite(floor) ? floor : box.min.z;
      for (const height of [low, low + RISE]) box.expandByPoint(box.min.clone().setZ(height));
    }
    return box;
  }

  lookAtAll() {
    const box = this.extent();
    const centre = box.getCenter(new vendor.Vector3());
    // so far away that a ball around everything fits into the narrower side of the picture
    const radius = Math.max(0.5, box.getSize(new vendor.Vector3()).length() / 2) + 0.15;
    const upright = (Math.PI / 180) * this.camera.fov;
    const lateral = 2 * Math.atan(Math.tan(upright / 2) * this.camera.aspect);
    const distance = radius / Math.sin(Math.min(upright, lateral) / 2);
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(new vendor.Vector3(0.42, -0.78, 0.46).normalize(), distance);
    this.controls.update();
    this.draw();
  }

  /** Draw floor, axes and box in the colours of the page. */
  paint() {
    this.surroundings.clear();
    this.models.forEach((model, k) => {
      const label = View3d.label(this.flight.drones[k].name, style("--ink"));
      if (this.models.length >= MANY) label.scale.multiplyScalar(0.6);
      if (model.label) model.group.remove(model.label);
      if (model.label) label.position.copy(model.label.position);
      model.label = label;
      model.group.add(label);
    });
    const { setup } = this.flight;
    const box = this.extent();
    const floor = Number.isFinite(setup.floor) ? setup.floor : Math.min(0, box.min.z);
    const reach = Math.max(2, 2 * Math.ceil(Math.max(...[box.min.x, box.min.y, box.max.x, box.max.y].map(Math.abs)) + 0.5));
    const line = new vendor.Color(style("--line"));
    const grid = new vendor.GridHelper(reach, Math.min(reach * 2, LINES), new vendor.Color(style("--quiet")), line);
    grid.rotation.x = Math.PI / 2;
    grid.position.z = floor;
    this.surroundings.add(grid);
    for (const [axis, text] of [[new vendor.Vector3(1, 0, 0), "x"], [new vendor.Vector3(0, 1, 0), "y"]]) {
      const label = View3d.label(`${text}, ${reach / 2} m`, style("--quiet"));
      label.scale.multiplyScalar(0.6);
      label.position.copy(axis.clone().multiplyScalar(reach / 2)).setZ(floor);
      this.surroundings.add(label);
    }
    if (Array.isArray(setup.box) && setup.box.every(Number.isFinite)) {
      const [x0, y0, z0, x1, y1, z1] = setup.box;
      if (x1 - x0 < 4 * reach && y1 - y0 < 4 * reach) {
        const room = new vendor.Box3(new vendor.Vector3(x0, y0, z0), new vendor.Vector3(x1, y1, z1));
        this.surroundings.add(new vendor.Box3Helper(room, new vendor.Color(style("--quiet"))));
      }
    }
    this.draw();
  }

  choose(chosen) {
    this.chosen = chosen;
    this.show(this.time || 0);
  }

  show(time) {
    this.time = time;
    this.flight.drones.forEach((drone, k) => {
      const model = this.models[k];
      const pose = this.chosen[k] ? drone.poseAt(time) : null;
      model.group.visible = pose !== null;
      if (!pose) return;
      model.body.position.set(...pose.position);
      model.body.quaternion.set(...pose.orientation).normalize();
      model.label.position.set(...pose.position);
      const reference = drone.referenceAt(time);
      for (const part of [model.reference, model.stick]) part.visible = reference !== null;
      const tube = drone.tubeAt(time);
      model.tube.visible = reference !== null && tube !== null;
      if (reference) {
        model.reference.position.set(...reference);
        model.tube.position.set(...reference);
        if (tube) model.tube.scale.set(tube[0], tube[0], tube[1]);
        const ends = model.stick.geometry.attributes.position;
        ends.setXYZ(0, ...pose.position);
        ends.setXYZ(1, ...reference);
        ends.needsUpdate = true;
      }
      View3d.lay(model.trail.geometry, drone.channel("pose"), time);
    });
    this.draw();
  }

  /** Lay the line of a trail along the poses of the last seconds. */
  static lay(geometry, poses, time) {
    const points = geometry.attributes.position;
    const last = poses.indexAt(time);
    const first = Math.max(0, poses.indexAt(time - TRAIL));
    const count = Math.min(TRAIL_POINTS, last - first + 1);
    for (let k = 0; k < count; k += 1) {
      const index = count < 2 ? last : Math.round(first + ((last - first) * k) / (count - 1));
      points.setXYZ(k, poses.columns[0][index], poses.columns[1][index], poses.columns[2][index]);
    }
    geometry.setDrawRange(0, Math.max(0, count));
    points.needsUpdate = true;
  }

  /** Give the graphics card back what it keeps for this view: browsers allow few of them. */
  close() {
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
  }
}
