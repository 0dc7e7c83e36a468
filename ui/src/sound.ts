// A sound for the signs that people wait for, if they switched it on.
const STORED = "scand-sound";

/** Frequencies in hertz, one after the other. */
const TONES: Record<string, number[]> = {
  hands_may_move: [880],
  safe: [880, 1175],
  green: [660, 880, 1175],
  amber: [660, 660],
  red: [330, 220],
  failed: [220, 220, 220],
  model_failed: [330, 220],
};

let context: AudioContext | null = null;

export function isOn(): boolean {
  return localStorage.getItem(STORED) === "on";
}

export function turn(on: boolean): void {
  localStorage.setItem(STORED, on ? "on" : "off");
  if (on) play("hands_may_move");
}

/** How late a tone may be: a browser holds it back until somebody touches the page. */
const LATE_MS = 1000;

export function play(sign: string): void {
  const tones = TONES[sign];
  if (!isOn() || !tones) return;
  context ??= new AudioContext();
  const wanted = performance.now();
  void running(context).then(() => {
    if (performance.now() - wanted < LATE_MS) tones.forEach((frequency, n) => tone(frequency, n * 0.18));
  });
}

/** Lets sounds through, as browsers allow it when somebody touches the page. */
export function wake(): void {
  if (!isOn()) return;
  context ??= new AudioContext();
  void running(context);
}

async function running(context: AudioContext): Promise<void> {
  if (context.state !== "running") await context.resume();
}

function tone(frequency: number, after_s: number): void {
  if (!context) return;
  const oscillator = context.createOscillator();
  const gain = context.createGain();
  oscillator.frequency.value = frequency;
  gain.gain.value = 0.2;
  oscillator.connect(gain).connect(context.destination);
  oscillator.start(context.currentTime + after_s);
  oscillator.stop(context.currentTime + after_s + 0.14);
}
