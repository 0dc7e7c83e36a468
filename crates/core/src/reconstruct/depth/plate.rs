//! A weak plate through the depth, a thin plate in the mathematical sense: the surface that stays near the readings
//! and bends as little as it can, except where it would bend so strongly that there must be an edge; there it
//! breaks (a thin plate under a bounded penalty, after Blake and Zisserman, "Visual Reconstruction", 1987, chapter
//! 2, solved by iteratively reweighted least squares). It extends slopes into holes and reproduces every plane
//! exactly.

use super::window::Window;
use crate::image::Grid;
use crate::statistics::upper_quantile;

/// What the plate is made of, in units in which the readings' error is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plate {
    /// Weight of bending against distance from the readings.
    pub stiffness: f32,
    /// Second difference (errors a pixel squared) at which the plate begins to break.
    pub bend_limit: f32,
    /// The same in the first round, in units of the bending that the readings' noise makes; from there it
    /// falls to `bend_limit`.
    pub noise_bend: f32,
    /// Reweightings.
    pub rounds: usize,
    /// Steps of conjugate gradients a reweighting.
    pub steps: usize,
    /// Standard deviation in pixels of the window over which the sensor takes the mean of a surface.
    pub window_sigma_px: f32,
    /// Difference between neighbouring pixels, in the unit of the depth, beyond which they are not of one
    /// surface.
    pub edge: f32,
}

impl Plate {
    /// From the `first` limit to the last in equal ratios.
    fn bend_limit_in(&self, round: usize, first: f32) -> f32 {
        let first = first.max(self.bend_limit);
        let last = self.rounds.saturating_sub(1).max(1) as f32;
        first * (self.bend_limit / first).powf(round as f32 / last)
    }
}

/// The system's fields, with a border of one pixel all round that stays 0, so that no stencil needs a
/// bounds check.
struct Fields {
    stride: usize,
    rows: usize,
    /// Weight of the reading at each pixel.
    confidence: Vec<f32>,
    /// Weights of the bending in x, y and across, 0 where a stencil leaves the surface.
    bend: [Vec<f32>; 3],
    /// The same with everything whole.
    unbroken: [Vec<f32>; 3],
}

/// Lays a plate through `start` (0 where there is no surface), which may be depth or inverse depth.
/// `confidence` is the weight of the reading that `start` has at a pixel, 0 where it was only filled in;
/// `error` is the readings' expected error in the same unit.
pub(super) fn fill_in(
    start: &Grid<f32>,
    confidence: &Grid<f32>,
    error: f32,
    plate: &Plate,
) -> Grid<f32> {
    let (width, height) = (start.width(), start.height());
    if width == 0 || height == 0 {
        return start.clone();
    }
    let (stride, rows) = (width + 2, height + 2);
    let origin = middle(start);
    let mut z = vec![0.0; stride * rows];
    let mut weights = vec![0.0; stride * rows];
    let mut surface = vec![false; stride * rows];
    for y in 0..height {
        for x in 0..width {
            let i = (y + 1) * stride + x + 1;
            if start[(x, y)] > 0.0 {
                surface[i] = true;
                z[i] = (start[(x, y)] - origin) / error;
                weights[i] = confidence[(x, y)];
            }
        }
    }
    let mut fields = Fields::new(stride, rows, weights, &surface);
    let readings = z.clone();
    let window = Window::new(
        stride,
        &surface,
        &z,
        plate.window_sigma_px,
        plate.edge / error,
    );
    let mut sharpened = readings.clone();
    let first = plate.noise_bend * fields.noise_bend(&z);
    for round in 0..plate.rounds {
        if round > 0 {
            window.sharpen(&readings, &z, &mut sharpened);
        }
        fields.reweight(&z, plate.stiffness, plate.bend_limit_in(round, first));
        fields.solve(&mut z, &sharpened, plate.steps);
    }
    Grid::from_fn(width, height, |x, y| {
        let i = (y + 1) * stride + x + 1;
        if surface[i] {
            z[i] * error + origin
        } else {
            0.0
        }
    })
}

/// A value in the middle of the others: what the plate is measured from, so that f32 loses nothing.
fn middle(surface: &Grid<f32>) -> f32 {
    let valid = surface.pixels().iter().filter(|&&z| z > 0.0);
    let (low, high) = valid.fold((f32::INFINITY, 0.0f32), |(l, h), &z| (l.min(z), h.max(z)));
    if low.is_finite() {
        (low + high) / 2.0
    } else {
        0.0
    }
}

impl Fields {
    fn new(stride: usize, rows: usize, confidence: Vec<f32>, surface: &[bool]) -> Self {
        let whole = |offsets: &[isize]| -> Vec<f32> {
            (0..surface.len())
                .map(|i| {
                    let on = |o: &isize| {
                        i.checked_add_signed(*o)
                            .is_some_and(|j| surface.get(j) == Some(&true))
                    };
                    f32::from(offsets.iter().all(on))
                })
                .collect()
        };
        let s = stride as isize;
        let unbroken = [
            whole(&[-1, 0, 1]),
            whole(&[-s, 0, s]),
            whole(&[0, 1, s, s + 1]),
        ];
        Self {
            stride,
            rows,
            confidence,
            bend: unbroken.clone(),
            unbroken,
        }
    }

    /// How much the readings' noise bends the plate: the second differences along rows that one in five is
    /// larger than, over 1.28, which is their standard deviation if they are noise and edges are rare.
    fn noise_bend(&self, z: &[f32]) -> f32 {
        let known = |i: usize| self.confidence[i] > 0.0;
        let mut bends: Vec<f32> = (1..z.len().saturating_sub(1))
            .filter(|&i| known(i - 1) && known(i) && known(i + 1))
            .map(|i| (z[i - 1] - 2.0 * z[i] + z[i + 1]).abs())
            .collect();
        upper_quantile(&mut bends, 0.8).map_or(0.0, |bend| bend / 1.28)
    }

    /// Sets the weights of the bending by how much the plate bends now (Geman and McClure's penalty).
    fn reweight(&mut self, z: &[f32], stiffness: f32, bend_limit: f32) {
        let scale = (bend_limit * bend_limit).recip();
        let s = self.stride;
        for y in 1..self.rows - 1 {
            let row = y * s..(y + 1) * s - 1;
            for i in row.start + 1..row.end {
                let bends = [
                    z[i - 1] - 2.0 * z[i] + z[i + 1],
                    z[i - s] - 2.0 * z[i] + z[i + s],
                    z[i] - z[i + 1] - z[i + s] + z[i + s + 1],
                ];
                // The bending across counts twice.
                for (k, factor) in [(0, 1.0), (1, 1.0), (2, 2.0)] {
                    let t = 1.0 + bends[k] * bends[k] * scale;
                    self.bend[k][i] = stiffness * factor * self.unbroken[k][i] / (t * t);
                }
            }
        }
    }

    /// Steps of conjugate gradients, preconditioned by the diagonal, from `z`.
    fn solve(&self, z: &mut [f32], readings: &[f32], steps: usize) {
        let n = z.len();
        let inverse_diagonal = self.inverse_diagonal();
        let (mut applied, mut forces) = (vec![0.0; n], vec![0.0; 3 * n]);
        self.apply(z, &mut applied, &mut forces);
        let mut residual: Vec<f32> = (0..n)
            .map(|i| self.confidence[i] * readings[i] - applied[i])
            .collect();
        let mut direction: Vec<f32> = multiply(&residual, &inverse_diagonal);
        let mut energy = dot(&residual, &direction);
        for _ in 0..steps {
            if energy <= 1e-10 {
                break;
            }
            self.apply(&direction, &mut applied, &mut forces);
            let curvature = dot(&direction, &applied);
            if curvature <= 0.0 {
                break;
            }
            let step = (energy / curvature) as f32;
            for i in 0..n {
                z[i] += step * direction[i];
                residual[i] -= step * applied[i];
            }
            let preconditioned = multiply(&residual, &inverse_diagonal);
            let next = dot(&residual, &preconditioned);
            let keep = (next / energy) as f32;
            for (d, p) in direction.iter_mut().zip(&preconditioned) {
                *d = p + keep * *d;
            }
            energy = next;
        }
    }

    /// The system's matrix times `z`.
    fn apply(&self, z: &[f32], out: &mut [f32], forces: &mut [f32]) {
        let (s, n) = (self.stride, z.len());
        let (xx, rest) = forces.split_at_mut(n);
        let (yy, xy) = rest.split_at_mut(n);
        // Rows as slices of one length, so that the compiler needs no bounds checks and vectorises.
        for y in 1..self.rows - 1 {
            let at = y * s + 1;
            let m = s - 2;
            let (left, here, right) = (&z[at - 1..][..m], &z[at..][..m], &z[at + 1..][..m]);
            let (up, down) = (&z[at - s..][..m], &z[at + s..][..m]);
            let below_right = &z[at + s + 1..][..m];
            let [wxx, wyy, wxy] = [0, 1, 2].map(|k| &self.bend[k][at..][..m]);
            let (xx, yy, xy) = (&mut xx[at..][..m], &mut yy[at..][..m], &mut xy[at..][..m]);
            for i in 0..m {
                let twice = 2.0 * here[i];
                xx[i] = wxx[i] * (left[i] - twice + right[i]);
                yy[i] = wyy[i] * (up[i] - twice + down[i]);
                xy[i] = wxy[i] * (here[i] - right[i] - down[i] + below_right[i]);
            }
        }
        for y in 1..self.rows - 1 {
            let at = y * s + 1;
            let m = s - 2;
            let (left, here, right) = (&xx[at - 1..][..m], &xx[at..][..m], &xx[at + 1..][..m]);
            let (up, middle, down) = (&yy[at - s..][..m], &yy[at..][..m], &yy[at + s..][..m]);
            let (a, b) = (&xy[at..][..m], &xy[at - 1..][..m]);
            let (c, d) = (&xy[at - s..][..m], &xy[at - s - 1..][..m]);
            let (weight, z) = (&self.confidence[at..][..m], &z[at..][..m]);
            let out = &mut out[at..][..m];
            for i in 0..m {
                out[i] = weight[i] * z[i] + left[i] - 2.0 * here[i] + right[i] + up[i]
                    - 2.0 * middle[i]
                    + down[i]
                    + a[i]
                    - b[i]
                    - c[i]
                    + d[i];
            }
        }
    }

    fn inverse_diagonal(&self) -> Vec<f32> {
        let s = self.stride;
        let mut out = vec![0.0; self.confidence.len()];
        let [xx, yy, xy] = &self.bend;
        for y in 1..self.rows - 1 {
            for i in y * s + 1..(y + 1) * s - 1 {
                let diagonal = self.confidence[i]
                    + xx[i - 1]
                    + 4.0 * xx[i]
                    + xx[i + 1]
                    + yy[i - s]
                    + 4.0 * yy[i]
                    + yy[i + s]
                    + xy[i]
                    + xy[i - 1]
                    + xy[i - s]
                    + xy[i - s - 1];
                if diagonal > 1e-6 {
                    out[i] = diagonal.recip();
                }
            }
        }
        out
    }
}

fn multiply(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// Sum of products, in 8 partial sums in a fixed order: the compiler can vectorise it, and it is the same
/// on every machine.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [0.0f32; 8];
    let mut total = 0.0f64;
    // Short stretches in f32, their sum in f64.
    for (a, b) in a.chunks(1024).zip(b.chunks(1024)) {
        sums.fill(0.0);
        let (pairs_a, pairs_b) = (a.chunks_exact(8), b.chunks_exact(8));
        let rest: f32 = pairs_a
            .remainder()
            .iter()
            .zip(pairs_b.remainder())
            .map(|(a, b)| a * b)
            .sum();
        for (a, b) in pairs_a.zip(pairs_b) {
            for k in 0..8 {
                sums[k] += a[k] * b[k];
            }
        }
        total += f64::from(sums.iter().sum::<f32>() + rest);
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLATE: Plate = Plate {
        stiffness: 100.0,
        bend_limit: 0.3,
        noise_bend: 0.5,
        window_sigma_px: 0.0,
        edge: 10.0,
        rounds: 5,
        steps: 20,
    };

    fn everywhere(depth: &Grid<f32>) -> Grid<f32> {
        depth.map(|_| 1.0)
    }

    #[test]
    fn a_plane_stays_as_it_is_also_over_a_hole() {
        let plane = Grid::from_fn(30, 20, |x, y| 0.8 + 0.003 * x as f32 - 0.001 * y as f32);
        let hole = |x: usize, y: usize| (10..20).contains(&x) && (5..15).contains(&y);
        let known = Grid::from_fn(30, 20, |x, y| f32::from(!hole(x, y)));
        let laid = fill_in(&plane, &known, 1e-3, &PLATE);
        for (a, b) in laid.pixels().iter().zip(plane.pixels()) {
            assert!((a - b).abs() < 2e-6, "{a} {b}");
        }
    }

    #[test]
    fn the_sensors_window_is_taken_back_at_a_kink() {
        // A steep wall that meets a floor, and what a window of 2 px makes of it: the corner is filled by 4 mm.
        let kink = |x: f32| 0.88 - 0.005 * (x - 20.0).max(0.0);
        let truth = Grid::from_fn(40, 20, |x, _| kink(x as f32));
        let seen = Grid::from_fn(40, 20, |x, _| {
            let weight = |dx: f32| (-0.5 * (dx / 2.0).powi(2)).exp();
            let (sum, weights) = (-80..=80).fold((0.0, 0.0), |(sum, weights), i| {
                let dx = i as f32 * 0.1;
                (sum + weight(dx) * kink(x as f32 + dx), weights + weight(dx))
            });
            sum / weights
        });
        let off = |window_sigma_px: f32| {
            let plate = Plate {
                window_sigma_px,
                edge: 0.012,
                ..PLATE
            };
            let laid = fill_in(&seen, &everywhere(&seen), 1e-3, &plate);
            let errors = (5..35).map(|x| (laid[(x, 10)] - truth[(x, 10)]).abs());
            errors.sum::<f32>()
        };
        assert!(off(0.0) > 8e-3, "{}", off(0.0));
        assert!(off(2.0) < 0.5 * off(0.0), "{}", off(2.0));
    }

    #[test]
    fn a_step_stays_a_step() {
        let step = Grid::from_fn(30, 20, |x, _| if x < 15 { 0.80 } else { 0.83 });
        let laid = fill_in(&step, &everywhere(&step), 1e-3, &PLATE);
        for (a, b) in laid.pixels().iter().zip(step.pixels()) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn noise_falls_and_what_is_not_surface_stays_empty() {
        // An error of about 1 mm, new in every pixel.
        let noisy = |x: usize, y: usize| {
            let hash = (x * 7919 + y * 104_729 + x * x * y * 31) % 1009;
            (hash as f32 / 1009.0 - 0.5) * 3.5e-3
        };
        let depth = Grid::from_fn(40, 40, |x, y| if y < 5 { 0.0 } else { 0.85 + noisy(x, y) });
        let laid = fill_in(&depth, &everywhere(&depth), 1e-3, &PLATE);
        let rms = |of: &Grid<f32>| {
            let surface = of.pixels().iter().filter(|&&z| z > 0.0);
            (surface.map(|z| (z - 0.85).powi(2)).sum::<f32>() / (35.0 * 40.0)).sqrt()
        };
        assert!(
            rms(&laid) < 0.5 * rms(&depth),
            "{} {}",
            rms(&laid),
            rms(&depth)
        );
        assert!(laid.pixels()[..5 * 40].iter().all(|&z| z == 0.0));
    }

    #[test]
    fn nothing_to_lay_is_no_error() {
        let empty = Grid::filled(5, 4, 0.0);
        assert_eq!(fill_in(&empty, &empty, 1e-3, &PLATE), empty);
        let none = Grid::filled(0, 0, 0.0);
        assert_eq!(fill_in(&none, &none, 1e-3, &PLATE), none);
    }
}
