//! How long-running work reports its progress, and learns that it should stop.

/// Listens to a reconstruction. Called between steps from the thread that runs the reconstruction.
pub trait Progress: Sync {
    /// A stage begins.
    fn stage(&self, stage: Stage);

    /// Whether the work should end at the next step.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Hears nothing, stops nothing.
pub struct NoProgress;

impl Progress for NoProgress {
    fn stage(&self, _: Stage) {}
}

/// The stages of a reconstruction, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Silhouettes from masks or backgrounds.
    Silhouettes,
    /// The visual hull.
    Hull,
    /// Fairing it, where that is asked for.
    Fairing,
    /// Enhancing the depth bursts.
    Depth,
    /// Finding the concave regions.
    Region,
    /// Restoring their surface, and closing what that opened to the cameras.
    Restoration,
    /// Painting the model.
    Texture,
}

impl Stage {
    /// All stages in their order.
    pub const ALL: [Self; 7] = [
        Self::Silhouettes,
        Self::Hull,
        Self::Fairing,
        Self::Depth,
        Self::Region,
        Self::Restoration,
        Self::Texture,
    ];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Silhouettes => "silhouettes",
            Self::Hull => "visual hull",
            Self::Fairing => "fairing",
            Self::Depth => "depth",
            Self::Region => "concave regions",
            Self::Restoration => "restoration",
            Self::Texture => "texture",
        }
    }
}
