//! Random numbers that depend only on a key: a frame's noise is the same whichever thread makes it.

use std::f64::consts::TAU;
use std::sync::LazyLock;

/// A stream of random numbers (SplitMix64, Steele, Lea and Flood 2014).
#[derive(Clone, Debug)]
pub(crate) struct Random {
    state: u64,
}

impl Random {
    /// The stream of a key: purpose, camera, frame, row.
    pub(crate) fn new(key: &[u64]) -> Self {
        let mut state = 0x5ca2_d000_0000_0001;
        for &part in key {
            state = mixed(state ^ part.wrapping_mul(0xd6e8_feb8_6659_fd93));
        }
        Self { state }
    }

    /// 64 random bits.
    #[inline]
    pub(crate) fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed(self.state)
    }

    /// Uniform in [0, 1).
    #[inline]
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller 1958).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    /// Fills `values` with standard normal numbers from a table of 4096: ten times faster than
    /// [`Self::normal`], without the last hundredth of a per cent of the tails; enough for pixels.
    pub(crate) fn fill_normal(&mut self, values: &mut [f32]) {
        let table: &[f32; QUANTILES] = &QUANTILE;
        for five in values.chunks_mut(5) {
            let mut bits = self.bits();
            for value in five {
                *value = table[bits as usize % QUANTILES];
                bits >>= 12;
            }
        }
    }
}

fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

const QUANTILES: usize = 4096;

/// The normal distribution's value at the middle of each of 4096 equal parts, scaled to a variance of 1.
static QUANTILE: LazyLock<[f32; QUANTILES]> = LazyLock::new(|| {
    let values: Vec<f64> = (0..QUANTILES)
        .map(|k| normal_quantile((k as f64 + 0.5) / QUANTILES as f64))
        .collect();
    let variance = values.iter().map(|v| v * v).sum::<f64>() / QUANTILES as f64;
    std::array::from_fn(|k| (values[k] / variance.sqrt()) as f32)
});

/// Inverts the normal distribution by bisection of its integral (Abramowitz and Stegun 26.2.17, 7.5e-8).
fn normal_quantile(p: f64) -> f64 {
    let (mut low, mut high) = (-6.0, 6.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if normal_integral(middle) < p {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn normal_integral(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.2316419 * x.abs());
    let series = [
        1.330274429,
        -1.821255978,
        1.781477937,
        -0.356563782,
        0.319381530,
    ];
    let tail = series.iter().fold(0.0, |sum, c| (sum + c) * t) * (-x * x / 2.0).exp() / TAU.sqrt();
    if x > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    }

    #[test]
    fn normal_numbers_have_mean_0_deviation_1_and_tails() {
        let mut random = Random::new(&[1, 2]);
        let slow: Vec<f64> = (0..100_000).map(|_| random.normal()).collect();
        let mut fast = vec![0.0_f32; 100_000];
        random.fill_normal(&mut fast);
        let fast: Vec<f64> = fast.into_iter().map(f64::from).collect();
        for values in [slow, fast] {
            let (mean, deviation) = mean_and_deviation(&values);
            assert!(mean.abs() < 0.01, "{mean}");
            assert!((deviation - 1.0).abs() < 0.01, "{deviation}");
            let beyond_two = values.iter().filter(|v| v.abs() > 2.0).count() as f64;
            assert!(
                (beyond_two / 100_000.0 - 0.0455).abs() < 0.003,
                "{beyond_two}"
            );
        }
    }

    #[test]
    fn a_key_is_a_stream_of_its_own() {
        let stream = |key: &[u64]| Random::new(key).bits();
        assert_eq!(stream(&[1, 2]), stream(&[1, 2]));
        assert_ne!(stream(&[1, 2]), stream(&[2, 1]));
        assert_ne!(stream(&[1]), stream(&[1, 0]));
    }
}
