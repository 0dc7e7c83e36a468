//! Undoes the effect of the window over which a sensor matches its pattern, by correcting the readings. Knows
//! nothing of the surface that is fitted to them.

/// What a sensor makes of a surface that takes the mean over a window: diffusion along the links between
/// neighbours that are of one surface.
pub(super) struct Window {
    stride: usize,
    /// Share of the difference to the next pixel to the right, and to the one below, that a step evens out.
    right: Vec<f32>,
    down: Vec<f32>,
    steps: usize,
}

impl Window {
    /// Share of a difference that a step evens out: four of them stay below one half, so that it is stable.
    const LARGEST_SHARE: f32 = 0.2;

    pub(super) fn new(
        stride: usize,
        surface: &[bool],
        z: &[f32],
        sigma_px: f32,
        edge: f32,
    ) -> Self {
        // A step of share k has the variance 2 k.
        let variance = sigma_px * sigma_px;
        let steps = (variance / (2.0 * Self::LARGEST_SHARE)).ceil();
        let share = if steps > 0.0 {
            variance / (2.0 * steps)
        } else {
            0.0
        };
        let links = |offset: usize| {
            let linked = |i: usize| {
                surface[i]
                    && surface.get(i + offset) == Some(&true)
                    && (z[i] - z[i + offset]).abs() < edge
            };
            (0..z.len())
                .map(|i| if linked(i) { share } else { 0.0 })
                .collect()
        };
        Self {
            stride,
            right: links(1),
            down: links(stride),
            steps: steps as usize,
        }
    }

    /// The readings as a sensor without a window would give them, if `z` is the surface: changed by what the
    /// window changes of it (Van Cittert's iteration, one step of it).
    pub(super) fn sharpen(&self, readings: &[f32], z: &[f32], sharpened: &mut [f32]) {
        if self.steps == 0 {
            return;
        }
        let mut seen = z.to_vec();
        let mut next = z.to_vec();
        for _ in 0..self.steps {
            for i in self.stride..z.len() - self.stride {
                let here = seen[i];
                next[i] = here
                    + self.right[i] * (seen[i + 1] - here)
                    + self.right[i - 1] * (seen[i - 1] - here)
                    + self.down[i] * (seen[i + self.stride] - here)
                    + self.down[i - self.stride] * (seen[i - self.stride] - here);
            }
            std::mem::swap(&mut seen, &mut next);
        }
        for (i, out) in sharpened.iter_mut().enumerate() {
            *out = readings[i] + z[i] - seen[i];
        }
    }
}
