//! Smooth random fields: patterns on objects, unevenness of cloth, fixed patterns of sensors.

/// A smooth field in [0, 1] over space with features of about one unit (value noise, cubic blending).
pub(super) fn field(seed: u64, p: [f64; 3]) -> f64 {
    let cell = p.map(f64::floor);
    let blend = [0, 1, 2].map(|a| {
        let t = p[a] - cell[a];
        t * t * (3.0 - 2.0 * t)
    });
    let mut sum = 0.0;
    for corner in 0..8_u64 {
        let bit = |a: usize| (corner >> a & 1) as f64;
        let weight: f64 = (0..3)
            .map(|a| {
                if bit(a) == 1.0 {
                    blend[a]
                } else {
                    1.0 - blend[a]
                }
            })
            .product();
        sum += weight * at_corner(seed, [0, 1, 2].map(|a| (cell[a] + bit(a)) as i64));
    }
    sum
}

/// A number in [0, 1) for each point of a lattice.
fn at_corner(seed: u64, at: [i64; 3]) -> f64 {
    let mut h = seed ^ 0x9e37_79b9_7f4a_7c15;
    for v in at {
        h = (h ^ v as u64).wrapping_mul(0xff51_afd7_ed55_8ccd);
        h ^= h >> 32;
    }
    (h >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_smooth_and_fills_its_range() {
        let values: Vec<f64> = (0..10_000)
            .map(|k| field(3, [k as f64 * 0.01, 0.3, 7.7]))
            .collect();
        let steps = values.windows(2).map(|w| (w[1] - w[0]).abs());
        assert!(steps.fold(0.0, f64::max) < 0.02);
        let (low, high) = values
            .iter()
            .fold((1.0_f64, 0.0_f64), |(l, h), &v| (l.min(v), h.max(v)));
        assert!(low < 0.25 && high > 0.75, "{low} to {high}");
    }
}
