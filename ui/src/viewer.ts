// The viewer of a model: turns, zooms, shows colours, shape, provenance or expected error, and measures between two
// points, which can be moved. It loads nothing but the model itself.
import {
  AmbientLight,
  Box3,
  BufferAttribute,
  type BufferGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  type Material,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  PerspectiveCamera,
  Raycaster,
  Scene,
  SphereGeometry,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

/** What a tap did while somebody measures: the second point is awaited, it missed the object, or the distance in mm. */
export type Measured = "second" | "beside" | number;
export type Mode = "textured" | "shaded" | "provenance" | "error";

/** A colour of a way of showing: a provenance by number, or an error in mm; `isOpen` if larger errors have it too. */
export interface Shade {
  value: number;
  color: string;
  isOpen: boolean;
}

/** Colours of the provenances by their numbers, as on previews: told apart without red and green (Okabe and Ito). */
const PROVENANCE = ["#9ea6b2", "#56b4e9", "#00b282", "#f0e442", "#e05e00", "#966ebe"];
/** From small to large. */
const ERROR = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
/** The share of the vertices whose errors are within the scale: a few large ones would leave all others one colour. */
const WITHIN = 0.98;
const STEP = Math.PI / 16;
/** By how much one press of a button or a key zooms. */
const NEARER = 0.85;
/** From how far a model is seen at first, in its own diagonals. */
const START = 1.7;
/** A pointer that moved by more pixels between down and up turned the model, and did not tap it. */
const TAP = 8;
/** How near a pointer takes hold of a measured point, in pixels: a target of 48. */
const REACH = 24;
/** Radii of a measured point, of the one that Enter would take, and of the line between two, in pixels, however near
 * the model is seen. */
const DOT = 7;
const AIM = 4;
const LINE = 1.5;
const MARK = "#d55e00";

/** A measured point that a pointer has hold of. */
interface Grip {
  /** The pointer's number, and the point's. */
  pointer: number;
  point: number;
  /** From the pointer to the point, in pixels: a finger beside it does not hide where it goes. */
  offset: Vector2;
  isMoved: boolean;
}

export class Viewer {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(35, 1, 0.001, 20);
  private readonly controls: OrbitControls;
  private readonly textured = new Map<Mesh, Material | Material[]>();
  private readonly size: number;
  private readonly resized: ResizeObserver;
  private points: Vector3[] = [];
  /** What shows the measured points: a dot each, and a line; with radii in pixels. */
  private marks: { mesh: Mesh; radius: number }[] = [];
  private readonly ink = new MeshBasicMaterial({ color: MARK, depthTest: false });
  private grip: Grip | null = null;
  /** Whether the keyboard is used, which measures from the middle of the picture. */
  private isAiming = false;
  private isMeasuring = false;
  /** Whether the wheel alone zooms, and a finger turns in all directions: since a click or tap on the picture. */
  private isHeld = false;
  private pressed = new Vector2();
  /** The error at the end of the scale, and the largest one, in metres. */
  private endOfScale = 0;
  private largest = 0;
  private frame = 0;

  /** Loads a model into a canvas, unless `left` says that it is not wanted any more; `measured` hears what each tap did
   * while somebody measures. */
  static async open(
    canvas: HTMLCanvasElement,
    address: string,
    measured: (told: Measured) => void,
    left?: AbortSignal,
  ): Promise<Viewer> {
    return new Viewer(canvas, await meshesOf(address, left), measured);
  }

  /** Shows another level of detail of the same model, from where it is seen now; `show` chooses how. */
  async load(address: string): Promise<void> {
    const meshes = await meshesOf(address);
    for (const mesh of this.meshes) {
      this.scene.remove(mesh);
      mesh.geometry.dispose();
    }
    this.textured.clear();
    this.meshes = meshes;
    this.takeIn();
    this.draw();
  }

  private constructor(
    private readonly canvas: HTMLCanvasElement,
    private meshes: Mesh[],
    private readonly measured: (told: Measured) => void,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const box = this.takeIn();
    this.size = box.getSize(new Vector3()).length();
    this.light();
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.copy(box.getCenter(new Vector3()));
    this.camera.position.copy(this.controls.target).add(new Vector3(0.6, 0.5, 1).setLength(this.size * START));
    this.camera.near = this.size / 100;
    this.camera.far = this.size * 20;
    this.controls.minDistance = this.size / 10;
    this.controls.maxDistance = this.size * 8;
    this.controls.addEventListener("change", this.moved);
    this.controls.update();
    this.controls.saveState();
    this.moved();
    this.resized = new ResizeObserver(() => this.fit());
    this.resized.observe(canvas);
    canvas.addEventListener("keydown", this.key);
    canvas.addEventListener("pointermove", this.move);
    canvas.addEventListener("pointerup", this.up);
    canvas.addEventListener("pointercancel", this.cancel);
    canvas.addEventListener("pointerleave", this.left);
    canvas.addEventListener("focus", this.aim);
    canvas.addEventListener("blur", this.release);
    // Before the controls hear of it.
    canvas.addEventListener("pointerdown", this.down, { capture: true });
    canvas.addEventListener("wheel", this.wheel, { capture: true, passive: true });
    canvas.addEventListener("touchstart", this.touched, { passive: false });
    canvas.addEventListener("touchmove", this.touched, { passive: false });
    canvas.addEventListener("webglcontextrestored", this.restored);
    this.hold(false);
    this.fit();
  }

  /** Puts the meshes into the scene; returns the box around them. */
  private takeIn(): Box3 {
    const box = new Box3();
    for (const mesh of this.meshes) {
      this.textured.set(mesh, mesh.material);
      this.scene.add(mesh);
      box.expandByObject(mesh);
    }
    this.rank();
    return box;
  }

  /** Finds where the scale of the errors ends. */
  private rank(): void {
    const found: number[] = [];
    for (const mesh of this.meshes) {
      const errors = attribute(mesh.geometry, "_error");
      for (let n = 0; errors && n < errors.count; n++) found.push(errors.getX(n));
    }
    const sorted = Float64Array.from(found).sort();
    this.largest = sorted.at(-1) ?? 0;
    const high = sorted[Math.floor(WITHIN * (sorted.length - 1))] ?? 0;
    this.endOfScale = high > 0 ? high : this.largest;
  }

  private light(): void {
    this.scene.add(new AmbientLight(0xffffff, 1.6));
    for (const [x, y, z, strength] of [
      [1, 2, 2, 1.6],
      [-2, 1, -1, 0.8],
    ]) {
      const light = new DirectionalLight(0xffffff, strength);
      light.position.set(x, y, z);
      this.scene.add(light);
    }
  }

  private fit(): void {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Draws at the next frame; nothing is drawn while nothing moves. */
  private draw(): void {
    if (this.frame !== 0) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.scaleMarks();
      this.renderer.render(this.scene, this.camera);
    });
  }

  /** A browser may take the graphics away, from a tablet that slept for example, and give them back empty. */
  private readonly restored = () => this.draw();

  /** Shows the model in one of the ways. */
  show(mode: Mode): void {
    for (const mesh of this.meshes) {
      mesh.material = this.material(mesh, mode);
    }
    this.draw();
  }

  private material(mesh: Mesh, mode: Mode): Material | Material[] {
    if (mode === "textured") return this.textured.get(mesh) ?? mesh.material;
    if (mode === "shaded") return new MeshStandardMaterial({ color: 0xb8b4ac, roughness: 0.85 });
    const values = attribute(mesh.geometry, mode === "error" ? "_error" : "_provenance");
    if (!values) return new MeshStandardMaterial({ color: 0x888888 });
    const colors = new Float32Array(values.count * 3);
    for (let n = 0; n < values.count; n++) {
      this.color(values.getX(n), mode).toArray(colors, n * 3);
    }
    mesh.geometry.setAttribute("color", new BufferAttribute(colors, 3));
    // Errors are read off a scale, which light and shade would falsify.
    if (mode === "error") return new MeshBasicMaterial({ vertexColors: true });
    return new MeshStandardMaterial({ vertexColors: true, roughness: 1 });
  }

  private color(value: number, mode: Mode): Color {
    if (mode === "provenance") return new Color(PROVENANCE[Math.round(value)] ?? "#000000");
    const at = (this.endOfScale > 0 ? Math.min(value / this.endOfScale, 1) : 0) * (ERROR.length - 1);
    const low = Math.min(Math.floor(at), ERROR.length - 2);
    return new Color(ERROR[low]).lerp(new Color(ERROR[low + 1]), at - low);
  }

  /** What the colours of a way mean, from small to large; nothing where they are those of the object. */
  scale(mode: Mode): Shade[] {
    if (mode === "provenance") return PROVENANCE.map((color, value) => ({ value, color, isOpen: false }));
    if (mode !== "error") return [];
    const last = ERROR.length - 1;
    return ERROR.map((color, n) => {
      const value = (this.endOfScale * 1000 * n) / last;
      return { value, color, isOpen: n === last && this.largest > this.endOfScale };
    });
  }

  /** The next two points that are tapped are measured between; or, where they are not any more, none is. */
  measure(isMeasuring: boolean): void {
    this.isMeasuring = isMeasuring;
    this.points = [];
    this.grip = null;
    this.showPoints();
  }

  /** Sees the model from a part or a multiple of the distance. */
  private approach(factor: number): void {
    const offset = this.camera.position.clone().sub(this.controls.target).multiplyScalar(factor);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
  }

  zoomIn(): void {
    this.approach(NEARER);
  }

  zoomOut(): void {
    this.approach(1 / NEARER);
  }

  /** Shows the model from where it was seen first. */
  reset(): void {
    this.controls.reset();
  }

  private readonly moved = () => {
    const distance = this.camera.position.distanceTo(this.controls.target);
    // For whoever looks how near it is: 2.00 is half as far away as at first.
    this.canvas.dataset.zoom = ((this.size * START) / distance).toFixed(2);
    if (this.isAiming) this.showPoints();
    this.draw();
  };

  /** The picture keeps the wheel and vertical swipes to itself, or leaves them to the page, which scrolls. */
  private hold(isHeld: boolean): void {
    this.isHeld = isHeld;
    this.canvas.style.touchAction = isHeld ? "none" : "pan-y";
  }

  private readonly release = () => {
    this.isAiming = false;
    this.showPoints();
    this.hold(false);
  };

  /** Shows what Enter would take, to whoever came here with the keyboard. */
  private readonly aim = () => {
    this.isAiming = this.canvas.matches(":focus-visible");
    this.showPoints();
  };

  private readonly left = (event: PointerEvent) => {
    if (event.pointerType === "mouse") this.hold(false);
  };

  private readonly wheel = (event: WheelEvent) => {
    // A pinch on a touchpad comes as a wheel with Ctrl.
    if (!this.isHeld && !event.ctrlKey && !event.metaKey) event.stopImmediatePropagation();
  };

  private readonly touched = (event: TouchEvent) => {
    // Two fingers zoom, and one that has hold of a point moves it: neither scrolls.
    if ((event.touches.length > 1 || this.grip) && event.cancelable) event.preventDefault();
  };

  private readonly down = (event: PointerEvent) => {
    // While a point is moved, another finger neither turns the model nor measures.
    if (this.grip) {
      event.stopImmediatePropagation();
      return;
    }
    this.isAiming = false;
    this.pressed.set(event.clientX, event.clientY);
    const point = event.button === 0 ? this.pointAt(event) : -1;
    if (point < 0) return;
    // The controls do not hear of it, so the model does not turn.
    event.stopImmediatePropagation();
    this.canvas.setPointerCapture(event.pointerId);
    const offset = this.seenAt(this.points[point]).sub(this.placeOf(event));
    this.grip = { pointer: event.pointerId, point, offset, isMoved: false };
  };

  private readonly move = (event: PointerEvent) => {
    const { grip } = this;
    if (!grip) {
      this.canvas.style.cursor = this.pointAt(event) < 0 ? "" : "grab";
      return;
    }
    if (event.pointerId !== grip.pointer) return;
    // While a second point is awaited, it may be tapped close to the first one.
    grip.isMoved ||= !this.isMeasuring || !this.isTap(event);
    if (grip.isMoved) this.shift(grip.point, this.placeOf(event).add(grip.offset));
  };

  private readonly up = (event: PointerEvent) => {
    const { grip } = this;
    if (grip && event.pointerId !== grip.pointer) return;
    this.grip = null;
    if (grip?.isMoved || !this.isTap(event)) return;
    this.hold(true);
    if (!this.isMeasuring) return;
    this.takeAt(this.placeOf(event));
  };

  private readonly cancel = (event: PointerEvent) => {
    if (event.pointerId === this.grip?.pointer) this.grip = null;
  };

  /** Whether a pointer is where it was put down: a tap, and not the end of a turn. */
  private isTap(event: PointerEvent): boolean {
    return this.pressed.distanceTo(new Vector2(event.clientX, event.clientY)) <= TAP;
  }

  /** Where a pointer is in the picture, in pixels. */
  private placeOf(event: PointerEvent): Vector2 {
    const box = this.canvas.getBoundingClientRect();
    return new Vector2(event.clientX - box.left, event.clientY - box.top);
  }

  /** Where a point is seen in the picture, in pixels. */
  private seenAt(point: Vector3): Vector2 {
    const { width, height } = this.canvas.getBoundingClientRect();
    this.camera.updateMatrixWorld();
    const seen = point.clone().project(this.camera);
    return new Vector2(((seen.x + 1) / 2) * width, ((1 - seen.y) / 2) * height);
  }

  /** The measured point that a pointer would take hold of, the nearest; -1 if none is near. */
  private pointAt(event: PointerEvent): number {
    const place = this.placeOf(event);
    const away = this.points.map((point) => this.seenAt(point).distanceTo(place));
    const nearest = Math.min(...away);
    return nearest <= REACH ? away.indexOf(nearest) : -1;
  }

  /** The object's point that is seen at a place of the picture. */
  private hit(place: Vector2): Vector3 | undefined {
    const { width, height } = this.canvas.getBoundingClientRect();
    this.camera.updateMatrixWorld();
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2((place.x / width) * 2 - 1, 1 - (place.y / height) * 2), this.camera);
    return ray.intersectObjects(this.meshes, false)[0]?.point;
  }

  private middle(): Vector2 {
    const { width, height } = this.canvas.getBoundingClientRect();
    return new Vector2(width / 2, height / 2);
  }

  /** Takes what is seen at a place as the next point. */
  private takeAt(place: Vector2): void {
    const hit = this.hit(place);
    if (hit) this.take(hit);
    else this.measured("beside");
  }

  /** Moves a measured point to what is seen at a place; beside the object it stays where it was. */
  private shift(point: number, place: Vector2): void {
    const hit = this.hit(place);
    if (!hit) return;
    this.points[point] = hit;
    this.showPoints();
    if (this.points.length === 2) this.tell();
  }

  private take(point: Vector3): void {
    this.points.push(point);
    if (this.points.length === 2) {
      this.isMeasuring = false;
      this.tell();
    } else {
      this.measured("second");
    }
    this.showPoints();
  }

  /** Tells the distance between both points. */
  private tell(): void {
    const [from, to] = this.points;
    this.measured(from.distanceTo(to) * 1000);
  }

  /** Draws the points that are measured, the line between two of them, and the point that Enter would take. */
  private showPoints(): void {
    for (const { mesh } of this.marks) {
      this.scene.remove(mesh);
      mesh.geometry.dispose();
    }
    this.marks = [];
    for (const point of this.points) this.mark(new SphereGeometry(1), DOT).position.copy(point);
    const [from, to] = this.points;
    if (to) this.join(from, to);
    const aimed = this.isMeasuring && this.isAiming ? this.hit(this.middle()) : undefined;
    if (aimed) this.mark(new SphereGeometry(1), AIM).position.copy(aimed);
    this.draw();
  }

  /** Draws the line that was measured. */
  private join(from: Vector3, to: Vector3): void {
    const length = from.distanceTo(to);
    if (length === 0) return;
    const line = this.mark(new CylinderGeometry(1, 1, length, 8), LINE);
    line.position.copy(from).lerp(to, 0.5);
    const direction = to.clone().sub(from).divideScalar(length);
    line.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), direction);
  }

  /** Adds a mark of what is measured, which is seen through the object too. */
  private mark(geometry: BufferGeometry, radius: number): Mesh {
    const mesh = new Mesh(geometry, this.ink);
    mesh.renderOrder = 1;
    this.marks.push({ mesh, radius });
    this.scene.add(mesh);
    return mesh;
  }

  /** Gives marks the size on the screen that they have from every distance. */
  private scaleMarks(): void {
    const seen = 2 * Math.tan((this.camera.fov * Math.PI) / 360);
    for (const { mesh, radius } of this.marks) {
      const pixel = (seen * this.camera.position.distanceTo(mesh.position)) / this.canvas.clientHeight;
      const across = radius * pixel;
      mesh.scale.set(across, radius === LINE ? 1 : across, across);
    }
  }

  private readonly key = (event: KeyboardEvent) => {
    // With these, keys are the browser's: Ctrl and + makes all of the page larger.
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Enter" && this.isMeasuring) {
      event.preventDefault();
      this.isAiming = true;
      this.takeAt(this.middle());
      return;
    }
    const offset = this.camera.position.clone().sub(this.controls.target);
    const up = new Vector3(0, 1, 0);
    const side = new Vector3().crossVectors(up, offset).normalize();
    const turns: Record<string, () => void> = {
      ArrowLeft: () => offset.applyAxisAngle(up, -STEP),
      ArrowRight: () => offset.applyAxisAngle(up, STEP),
      ArrowUp: () => offset.applyAxisAngle(side, -STEP),
      ArrowDown: () => offset.applyAxisAngle(side, STEP),
      "+": () => offset.multiplyScalar(NEARER),
      "-": () => offset.multiplyScalar(1 / NEARER),
    };
    const turn = turns[event.key];
    if (!turn) return;
    event.preventDefault();
    this.isAiming = true;
    turn();
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
  };

  /** Frees what the viewer holds. */
  end(): void {
    cancelAnimationFrame(this.frame);
    this.resized.disconnect();
    this.canvas.removeEventListener("keydown", this.key);
    this.canvas.removeEventListener("pointerdown", this.down, { capture: true });
    this.canvas.removeEventListener("pointermove", this.move);
    this.canvas.removeEventListener("pointerup", this.up);
    this.canvas.removeEventListener("pointercancel", this.cancel);
    this.canvas.removeEventListener("pointerleave", this.left);
    this.canvas.removeEventListener("focus", this.aim);
    this.canvas.removeEventListener("blur", this.release);
    this.canvas.removeEventListener("wheel", this.wheel, { capture: true });
    this.canvas.removeEventListener("touchstart", this.touched);
    this.canvas.removeEventListener("touchmove", this.touched);
    this.canvas.removeEventListener("webglcontextrestored", this.restored);
    this.controls.dispose();
    for (const mesh of this.meshes) mesh.geometry.dispose();
    this.renderer.dispose();
    // A browser has a few of these for all pages; the canvas is not used again.
    this.renderer.forceContextLoss();
  }
}

async function meshesOf(address: string, left?: AbortSignal): Promise<Mesh[]> {
  const response = await fetch(address, { signal: left });
  if (!response.ok) throw new Error(`${response.status} ${response.statusText}`);
  // All of a model is in its one file.
  const loaded = await new GLTFLoader().parseAsync(await response.arrayBuffer(), "");
  const meshes: Mesh[] = [];
  loaded.scene.updateMatrixWorld(true);
  loaded.scene.traverse((node) => {
    if (node instanceof Mesh) meshes.push(node as Mesh);
  });
  // A compressed model's numbers are steps, which its node brings to metres.
  for (const mesh of meshes) mesh.matrixWorld.decompose(mesh.position, mesh.quaternion, mesh.scale);
  return meshes;
}

function attribute(geometry: BufferGeometry, name: string): BufferAttribute | null {
  const found = geometry.getAttribute(name);
  return found instanceof BufferAttribute ? found : null;
}
