"use strict";
// 3D view of the robot on its ground. World axes as in the program: x forward, y left, z up, m.

/** Index of the sample before a time, s, and interpolation weight of the sample after it. */
function sampleAt(result, rate, time) {
  const last = result.times - 1;
  const index = Math.max(0, Math.min(last - 1, Math.floor(time * rate)));
  const start = index / rate;
  const end = index + 1 === last ? result.horizon : (index + 1) / rate;
  return { index, weight: Math.max(0, Math.min(1, (time - start) / (end - start))) };
}

/** Interpolated value of a curve with `size` numbers per sample. */
function valueAt(values, size, { index, weight }) {
  const out = new Array(size);
  for (let i = 0; i < size; i++) {
    const [a, b] = [values[index * size + i], values[(index + 1) * size + i]];
    out[i] = a + weight * (b - a);
  }
  return out;
}

/** True if a foot is in stance at a time, s. */
function stands(foot, time) {
  return foot.stances.some(([start, end]) => time >= start - 1e-9 && time <= end + 1e-9);
}

/** Unit vectors of a sole: from heel to toe, and to the left. */
function axesAt(foot, at) {
  const values = valueAt(foot.axes, 6, at);
  const along = new THREE.Vector3(...values.slice(0, 3)).normalize();
  const left = new THREE.Vector3(...values.slice(3));
  return [along, left.addScaledVector(along, -left.dot(along)).normalize()];
}

/** Corners of a sole, as arrays. */
function cornersOf(foot, at) {
  const [along, left] = axesAt(foot, at);
  const place = new THREE.Vector3(...valueAt(foot.position, 3, at));
  const corner = (x, y) => place.clone().addScaledVector(along, (x * foot.sole[0]) / 2).addScaledVector(left, (y * foot.sole[1]) / 2).toArray();
  return [corner(1, 1), corner(1, -1), corner(-1, -1), corner(-1, 1)];
}

/** Convex hull of points in the xy plane, counter-clockwise. */
function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  if (sorted.length < 3) return sorted;
  const left = (o, a, b) => (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]) > 1e-12;
  const half = (list) => {
    const chain = [];
    for (const p of list) {
      while (chain.length > 1 && !left(chain.at(-2), chain.at(-1), p)) chain.pop();
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** Shaded ground with its edges and a grid of lines `step` apart in x and y, m. */
function groundOf(ground, step) {
  const { xs, ys, heights } = ground;
  const positions = [];
  const corner = (i, j) => [xs[i], ys[j], heights[i * ys.length + j]];
  for (let i = 0; i + 1 < xs.length; i++) {
    for (let j = 0; j + 1 < ys.length; j++) {
      const [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
      positions.push(...a, ...b, ...c, ...a, ...c, ...d);
    }
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(positions), 3));
  geometry.computeVertexNormals();
  const material = new THREE.MeshLambertMaterial({ color: 0xeef1f4, side: THREE.DoubleSide });
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nvarying vec3 vGround;\nvarying vec3 vGroundNormal;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvGround = position;\nvGroundNormal = normal;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nvarying vec3 vGround;\nvarying vec3 vGroundNormal;")
      .replace(
        "#include <color_fragment>",
        `#include <color_fragment>
        float steep = length(vGroundNormal.xy) / max(abs(vGroundNormal.z), 1e-3);
        diffuseColor.rgb = mix(diffuseColor.rgb, vec3(0.66, 0.71, 0.77), 1.0 - exp(-2.5 * steep));
        vec2 cell = vGround.xy / ${step.toFixed(3)};
        vec2 width = max(fwidth(cell), vec2(1e-5));
        vec2 lines = abs(fract(cell - 0.5) - 0.5) / width;
        float line = (1.0 - min(min(lines.x, lines.y), 1.0)) * (1.0 - smoothstep(0.15, 0.5, max(width.x, width.y)));
        diffuseColor.rgb = mix(diffuseColor.rgb, vec3(0.62, 0.67, 0.73), 0.55 * line);`,
      );
  };
  const mesh = new THREE.Mesh(geometry, material);
  mesh.receiveShadow = true;
  const group = new THREE.Group();
  const edges = new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 18), new THREE.LineBasicMaterial({ color: 0x8492a1 }));
  group.add(mesh, edges);
  return group;
}

/** Line through points `[x, y, z, x, ...]`. Its width is in pixels. */
function pathOf(points, color, width, opacity) {
  const geometry = new THREE.LineGeometry();
  geometry.setPositions(points);
  const material = new THREE.LineMaterial({ color, linewidth: width, transparent: opacity < 1, opacity });
  return new THREE.Line2(geometry, material);
}

/** Rod along y from 0 to 1, which `span` places between two points. */
function rodOf(radius, material, top = radius) {
  const geometry = new THREE.CylinderGeometry(top, radius, 1, 14);
  geometry.translate(0, 0.5, 0);
  const mesh = new THREE.Mesh(geometry, material);
  mesh.castShadow = true;
  return mesh;
}

const UP = new THREE.Vector3(0, 1, 0);

/** Places a rod between two points. */
function span(mesh, from, to) {
  const direction = new THREE.Vector3().subVectors(to, from);
  const length = direction.length();
  mesh.position.copy(from);
  mesh.scale.set(1, Math.max(length, 1e-6), 1);
  if (length > 1e-9) mesh.quaternion.setFromUnitVectors(UP, direction.divideScalar(length));
}

/** Base positions averaged over `half` s to both sides. The camera follows this path, so that it does not shake. */
function smoothPath(result, rate, half) {
  const count = result.times;
  const reach = Math.round(half * rate);
  const sums = [0, 0, 0].map((_, axis) => {
    const sum = [0];
    for (let i = 0; i < count; i++) sum.push(sum[i] + result.position[3 * i + axis]);
    return sum;
  });
  const out = [];
  for (let i = 0; i < count; i++) {
    const around = Math.min(reach, i, count - 1 - i);
    for (const sum of sums) out.push((sum[i + around + 1] - sum[i - around]) / (2 * around + 1));
  }
  return out;
}

/** Drawing of a robot: body, legs, feet and force arrows, with a method that poses them. */
class RobotModel {
  constructor(result, colors) {
    this.result = result;
    this.group = new THREE.Group();
    const leg = result.leg;
    const size = result.body;
    this.body = new THREE.Group();
    const box = new THREE.BoxGeometry(...size);
    const hull = new THREE.Mesh(box, new THREE.MeshStandardMaterial({ color: 0xb9c5d1, roughness: 0.7, transparent: true, opacity: 0.9 }));
    hull.castShadow = true;
    const rim = new THREE.LineSegments(new THREE.EdgesGeometry(box), new THREE.LineBasicMaterial({ color: 0x4a5866 }));
    this.body.add(hull, rim);
    this.axes = new THREE.Group();
    [[0, 0x9b2f2f], [1, 0x2f7d46], [2, 0x2b4c9b]].forEach(([axis, color]) => {
      const end = new THREE.Vector3().setComponent(axis, 0.75 * leg);
      const material = new THREE.MeshBasicMaterial({ color });
      const rod = rodOf(0.012 * leg, material);
      rod.castShadow = false;
      span(rod, new THREE.Vector3(), end);
      const tip = new THREE.Mesh(new THREE.ConeGeometry(0.035 * leg, 0.1 * leg, 12), material);
      tip.position.copy(end);
      tip.quaternion.setFromUnitVectors(UP, end.clone().normalize());
      this.axes.add(rod, tip);
    });
    this.body.add(this.axes);
    this.hips = result.feet.map((f) => new THREE.Vector3(...f.hip));
    this.legs = colors.map((color) => rodOf(0.042 * leg, new THREE.MeshStandardMaterial({ color, roughness: 0.6 }), 0.055 * leg));
    // With a joint model, a leg is a chain of rods from joint to joint and to the foot.
    this.links = result.feet.map((foot, i) => {
      const material = new THREE.MeshStandardMaterial({ color: colors[i], roughness: 0.6 });
      return Array.from({ length: foot.joints }, () => rodOf(0.042 * leg, material, 0.05 * leg));
    });
    this.legs.forEach((rod, i) => (rod.visible = this.links[i].length === 0));
    this.balls = colors.map((color, i) => {
      const { sole, radius } = result.feet[i];
      const shape = sole ? new THREE.BoxGeometry(...sole, 0.03 * leg) : new THREE.SphereGeometry(radius || 0.075 * leg, 24, 16);
      const ball = new THREE.Mesh(shape, new THREE.MeshStandardMaterial({ color, roughness: 0.5 }));
      ball.castShadow = true;
      return ball;
    });
    this.boxes = new THREE.Group();
    result.feet.forEach((foot, i) => {
      const edges = new THREE.BufferGeometry();
      edges.setAttribute("position", new THREE.BufferAttribute(new Float32Array(foot.reach), 3));
      const wire = new THREE.LineSegments(edges, new THREE.LineBasicMaterial({ color: colors[i], transparent: true, opacity: 0.7 }));
      this.boxes.add(wire);
    });
    this.body.add(this.boxes);
    this.forces = new THREE.Group();
    this.arrows = colors.map((color) => {
      const material = new THREE.MeshBasicMaterial({ color });
      const arrow = { rod: rodOf(0.02 * leg, material), tip: new THREE.Mesh(new THREE.ConeGeometry(0.06 * leg, 0.16 * leg, 14), material) };
      arrow.rod.castShadow = false;
      this.forces.add(arrow.rod, arrow.tip);
      return arrow;
    });
    // The arrow of the largest allowed force is as long as two legs.
    this.metresPerNewton = (2 * leg) / Math.max(result.force_limit, 0.5 * result.weight);
    this.support = new THREE.Group();
    const corners = result.feet.reduce((count, foot) => count + (foot.sole ? 4 : 1), 0);
    this.area = new THREE.BufferGeometry();
    this.area.setAttribute("position", new THREE.BufferAttribute(new Float32Array(9 * Math.max(1, corners - 2)), 3));
    this.outline = new THREE.BufferGeometry();
    this.outline.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * (corners + 1)), 3));
    const fill = new THREE.MeshBasicMaterial({ color: 0x0b62a8, transparent: true, opacity: 0.16, side: THREE.DoubleSide, depthWrite: false });
    const areaMesh = new THREE.Mesh(this.area, fill);
    const outline = new THREE.Line(this.outline, new THREE.LineBasicMaterial({ color: 0x0b62a8 }));
    areaMesh.frustumCulled = outline.frustumCulled = false;
    this.support.add(areaMesh, outline);
    this.group.add(this.body, ...this.legs, ...this.links.flat(), ...this.balls, this.forces, this.support);
  }

  pose(at, time) {
    const { result } = this;
    const [roll, pitch, yaw] = valueAt(result.angles, 3, at);
    this.body.position.set(...valueAt(result.position, 3, at));
    this.body.rotation.set(roll, pitch, yaw, "ZYX");
    this.body.updateMatrixWorld();
    const standing = [];
    result.feet.forEach((foot, i) => {
      const place = new THREE.Vector3(...valueAt(foot.position, 3, at));
      const center = place.clone().setZ(place.z + foot.radius);
      const chain = this.links[i];
      if (chain.length === 0) {
        span(this.legs[i], place, this.hips[i].clone().applyMatrix4(this.body.matrixWorld));
      } else {
        const joints = valueAt(foot.links, 3 * chain.length, at);
        const points = chain.map((_, j) => new THREE.Vector3(...joints.slice(3 * j, 3 * j + 3)).applyMatrix4(this.body.matrixWorld));
        points.push(center);
        chain.forEach((rod, j) => span(rod, points[j + 1], points[j]));
      }
      this.balls[i].position.copy(center);
      if (foot.sole) {
        const [along, left] = axesAt(foot, at);
        this.balls[i].quaternion.setFromRotationMatrix(this.body.matrixWorld.clone().makeBasis(along, left, along.clone().cross(left)));
      }
      const stance = stands(foot, time);
      if (stance) standing.push(...(foot.sole ? cornersOf(foot, at) : [[place.x, place.y, place.z]]));
      const force = new THREE.Vector3(...valueAt(foot.force, 3, at));
      const { rod, tip } = this.arrows[i];
      rod.visible = tip.visible = stance && force.length() > 1e-3 * result.weight;
      if (rod.visible) {
        const origin = foot.sole ? new THREE.Vector3(...valueAt(foot.pressure, 3, at)) : place;
        const end = origin.clone().addScaledVector(force, this.metresPerNewton);
        span(rod, origin, end);
        tip.position.copy(end);
        tip.quaternion.copy(rod.quaternion);
      }
    });
    this.drawSupport(hull(standing));
  }

  drawSupport(corners) {
    const lift = 0.012 * this.result.leg;
    const point = (attribute, i, [x, y, z]) => attribute.setXYZ(i, x, y, z + lift);
    const area = this.area.attributes.position;
    let count = 0;
    for (let i = 1; i + 1 < corners.length; i++) {
      for (const corner of [corners[0], corners[i], corners[i + 1]]) point(area, count++, corner);
    }
    this.area.setDrawRange(0, count);
    const outline = this.outline.attributes.position;
    [...corners, ...corners.slice(0, 1)].forEach((corner, i) => point(outline, i, corner));
    this.outline.setDrawRange(0, corners.length > 1 ? corners.length + 1 : 0);
    area.needsUpdate = outline.needsUpdate = true;
  }
}

/** Camera positions relative to the point that they look at, before scaling. */
const VIEWS = { Oblique: [0.62, -1, 0.5], Side: [0.001, -1.2, 0.14], Front: [1.2, 0.001, 0.22], Top: [0, -0.001, 1.6] };

/** Layers: label, and true if the layer is shown initially. */
const LAYERS = {
  forces: ["Forces", true],
  support: ["Support polygon", true],
  com: ["Path of the centre of mass", true],
  footholds: ["Planned footholds", true],
  paths: ["Paths of the feet", true],
  axes: ["Axes of the base", true],
  boxes: ["Reach of the feet", false],
  follow: ["Camera follows", true],
};

/** 3D view of one result on a canvas. The constructor throws if WebGL is not available. */
class SceneView {
  constructor(canvas, result, data) {
    this.result = result;
    this.rate = data.rate;
    const colors = result.feet.map((_, i) => data.colors[i]);
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: false });
    this.renderer.shadowMap.enabled = true;
    this.canvas = canvas;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0xfbfcfd);
    this.camera = new THREE.PerspectiveCamera(36, 1, 0.02 * result.leg, 400 * result.leg);
    this.camera.up.set(0, 0, 1);
    const leg = result.leg;
    // Distance of the grid lines: half a leg, rounded up to one of these lengths.
    const step = [0.05, 0.1, 0.25, 0.5, 1].find((s) => s >= 0.5 * leg) ?? 1;
    this.gridStep = step;
    this.scene.add(groundOf(result.ground, step));
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xccd4dc, 2.1));
    this.sun = new THREE.DirectionalLight(0xffffff, 1.7);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    const reach = 5 * leg;
    Object.assign(this.sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1 * leg, far: 30 * leg });
    this.sun.shadow.normalBias = 0.02 * leg;
    this.scene.add(this.sun, this.sun.target);
    this.model = new RobotModel(result, colors);
    this.scene.add(this.model.group);
    this.layers = { forces: this.model.forces, support: this.model.support, axes: this.model.axes, boxes: this.model.boxes };
    this.addPaths(colors);
    this.addFootholds(colors);
    this.addGoal();
    this.smooth = smoothPath(result, this.rate, 0.4);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.minDistance = leg;
    this.controls.maxDistance = 60 * leg;
    this.controls.maxPolarAngle = 0.56 * Math.PI;
    this.controls.addEventListener("change", () => (this.dirty = true));
    this.follow = true;
    this.dirty = true;
    for (const [name, [, shown]] of Object.entries(LAYERS)) this.show(name, shown);
    this.time = 0;
    this.setTime(0);
    this.setView("Oblique");
  }

  addPaths(colors) {
    const { result } = this;
    this.layers.com = new THREE.Group();
    this.layers.com.add(pathOf(result.position, 0x8a96a3, 1.5, 0.8));
    this.past = pathOf(result.position, 0x33475b, 2.2, 1);
    this.layers.com.add(this.past);
    this.layers.paths = new THREE.Group();
    result.feet.forEach((foot, i) => this.layers.paths.add(pathOf(foot.position, colors[i], 1.3, 0.45)));
    this.scene.add(this.layers.com, this.layers.paths);
  }

  addFootholds(colors) {
    const { result } = this;
    const leg = result.leg;
    this.layers.footholds = new THREE.Group();
    const ring = new THREE.RingGeometry(0.085 * leg, 0.115 * leg, 28);
    result.feet.forEach((foot, i) => {
      const material = new THREE.MeshBasicMaterial({ color: colors[i], side: THREE.DoubleSide });
      for (const [x, y, z, nx, ny, nz] of foot.footholds) {
        const mesh = new THREE.Mesh(ring, material);
        const normal = new THREE.Vector3(nx, ny, nz);
        mesh.position.set(x, y, z).addScaledVector(normal, 0.008 * leg);
        mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), normal);
        this.layers.footholds.add(mesh);
      }
    });
    this.scene.add(this.layers.footholds);
  }

  /** Adds the goal of the base: a ball with an arrow along its yaw. */
  addGoal() {
    const { goal, goal_yaw: yaw, leg } = this.result;
    const material = new THREE.MeshBasicMaterial({ color: 0x1d2733 });
    const at = new THREE.Vector3(...goal);
    const ball = new THREE.Mesh(new THREE.SphereGeometry(0.04 * leg, 16, 12), material);
    ball.position.copy(at);
    const ahead = new THREE.Vector3(Math.cos(yaw), Math.sin(yaw), 0).multiplyScalar(0.9 * leg).add(at);
    const rod = rodOf(0.012 * leg, material);
    rod.castShadow = false;
    span(rod, at, ahead);
    const tip = new THREE.Mesh(new THREE.ConeGeometry(0.04 * leg, 0.12 * leg, 12), material);
    tip.position.copy(ahead);
    tip.quaternion.copy(rod.quaternion);
    this.scene.add(ball, rod, tip);
  }

  /** Point that the camera looks at. */
  focus() {
    const point = new THREE.Vector3(...valueAt(this.smooth, 3, sampleAt(this.result, this.rate, this.time)));
    point.z -= 0.45 * this.result.leg;
    return point;
  }

  setView(name) {
    const { feet, leg } = this.result;
    const size = Math.max(2.2 * leg, ...feet.map((f) => 2 * Math.hypot(f.nominal[0], f.nominal[1])));
    this.at = this.focus();
    this.controls.target.copy(this.at);
    this.camera.position.set(...VIEWS[name]).multiplyScalar(1.8 * size).add(this.at);
    this.controls.update();
    this.dirty = true;
  }

  show(name, shown) {
    if (name === "follow") this.follow = shown;
    else this.layers[name].visible = shown;
    if (name === "follow" && this.at) this.at = this.focus();
    this.dirty = true;
  }

  setTime(time) {
    this.time = Math.max(0, Math.min(this.result.horizon, time));
    const at = sampleAt(this.result, this.rate, this.time);
    this.model.pose(at, this.time);
    this.past.geometry.instanceCount = at.index + (at.weight > 0.5 ? 1 : 0);
    const focus = this.focus();
    if (this.follow && this.at) {
      const shift = focus.clone().sub(this.at);
      this.camera.position.add(shift);
      this.controls.target.add(shift);
      this.controls.update();
    }
    this.at = focus;
    this.sun.target.position.copy(focus);
    this.sun.position.copy(focus).add(new THREE.Vector3(-3, -4, 9).multiplyScalar(this.result.leg));
    this.dirty = true;
  }

  /** Draws at the current size of the canvas if anything has changed. */
  render() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || !height) return;
    if (this.width !== width || this.height !== height || this.ratio !== devicePixelRatio) {
      [this.width, this.height, this.ratio] = [width, height, devicePixelRatio];
      this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.dirty = true;
    }
    if (!this.dirty) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
  }
}
