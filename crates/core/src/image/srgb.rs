//! Converts between sRGB-encoded values and linear light (IEC 61966-2-1). Light mixes linearly: a pixel that a
//! contour halves is the mean of both sides' linear values.

use crate::array::three;
use std::sync::LazyLock;

static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|v| exact(v as f32)));

/// Linear light, in [0, 1], of all 256 encoded values.
#[inline]
pub fn linear_from_srgb() -> &'static [f32; 256] {
    &LINEAR
}

fn exact(srgb: f32) -> f32 {
    let v = srgb / 255.0;
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// Linear light, in [0, 1], of an encoded value between whole numbers, in [0, 255]: interpolated, exact to
/// 1e-5.
#[inline]
pub fn decode(srgb: f32) -> f32 {
    interpolated(linear_from_srgb(), srgb)
}

/// [`decode`] of a pixel's three values.
#[inline]
pub fn decode_pixel(srgb: [f32; 3]) -> [f32; 3] {
    let linear = linear_from_srgb();
    three(|c| interpolated(linear, srgb[c]))
}

#[inline]
fn interpolated(linear: &[f32; 256], srgb: f32) -> f32 {
    let low = srgb.clamp(0.0, 254.0) as usize;
    let (a, b) = (linear[low], linear[low + 1]);
    a + (b - a) * (srgb - low as f32)
}

static SLOPE: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|v| {
        let (low, high) = (v.saturating_sub(2), (v + 2).min(255));
        (LINEAR[high] - LINEAR[low]) / (high - low) as f32
    })
});

/// Linear light over encoded units, at all 256 encoded values.
pub fn derivatives() -> &'static [f32; 256] {
    &SLOPE
}

/// Encoded value, in [0, 255], of linear light; light beyond [0, 1] is clipped.
#[inline]
pub fn encode(linear: f32) -> f32 {
    let l = linear.clamp(0.0, 1.0);
    255.0
        * if l <= 0.003_130_8 {
            12.92 * l
        } else {
            1.055 * l.powf(1.0 / 2.4) - 0.055
        }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_inverts_decoding() {
        for v in 0..=255u8 {
            let back = encode(linear_from_srgb()[usize::from(v)]);
            assert!((back - f32::from(v)).abs() < 1e-2, "{v}: {back}");
        }
        for v in 0..2550 {
            let v = v as f32 / 10.0;
            assert!((decode(v) - exact(v)).abs() < 1e-5, "{v}");
        }
        // The standard's own mid grey: 18 % reflects as 118 (117.6).
        assert!((encode(0.18) - 117.6).abs() < 0.1);
    }
}
