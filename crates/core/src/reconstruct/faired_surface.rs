//! The surface that a model starts from: that of the faired hull, where fairing is asked for and its result is one that
//! a model can be made from, or else that of the plain hull. Uses no depth and carves nothing.

use super::fairing::{self, Faired, Refusal};
use super::hull::{self, ExtractedSurface, Fairing, Hull};
use super::surface::Lattice;
use crate::mesh::{Component, Mesh, check, components};
use nalgebra::Point3;

/// A faired hull with its surface.
pub(super) struct FairedSurface {
    pub(super) faired: Faired,
    pub(super) extracted: ExtractedSurface,
}

/// A hull's fairing, or why nothing of it may be faired; `None` where that is not asked for.
pub(super) type FairingResult = Option<Result<FairedSurface, Refusal>>;

/// A hull that may be faired, with its surface.
pub(super) struct PlainHull<'a> {
    pub(super) hull: &'a Hull<'a>,
    pub(super) lattice: &'a Lattice,
    pub(super) extracted: &'a ExtractedSurface,
    /// Whether it is the hull of several captures.
    pub(super) is_fused: bool,
    pub(super) parameters: &'a hull::Parameters,
}

impl PlainHull<'_> {
    /// Fairs it.
    pub(super) fn faired(&self) -> FairingResult {
        match self.parameters.fairing {
            Fairing::None => None,
            Fairing::Touch => Some(self.faired_by_touch()),
        }
    }

    /// The surface that a model starts from.
    pub(super) fn start<'s>(&'s self, fairing: &'s FairingResult) -> &'s ExtractedSurface {
        match fairing {
            Some(Ok(surface)) => &surface.extracted,
            _ => self.extracted,
        }
    }

    /// The faired hull again, but plain at `places` on it, where depth cameras read the object in front of it.
    pub(super) fn held_at(
        &self,
        surface: FairedSurface,
        places: &[Point3<f64>],
    ) -> Result<FairedSurface, Refusal> {
        let FairedSurface { faired, extracted } = surface;
        let faired = faired.held_at(places);
        if places.is_empty() {
            return Ok(FairedSurface { faired, extracted });
        }
        self.checked(faired)
    }

    fn faired_by_touch(&self) -> Result<FairedSurface, Refusal> {
        let plain = &self.extracted.surface.mesh;
        let faired = fairing::fair_hull(self.hull, self.lattice, plain, self.parameters)?;
        self.checked(faired)
    }

    /// The surface of a faired hull, if it is closed and has the plain one's pieces and handles.
    fn checked(&self, faired: Faired) -> Result<FairedSurface, Refusal> {
        let extracted = hull::extract_solid(&faired.solid, self.lattice, self.parameters);
        let extracted = extracted.ok_or(Refusal::TooThin)?;
        if !check(&extracted.surface.mesh).is_watertight() {
            return Err(Refusal::Open);
        }
        // A handle or a piece more or less is no rounding of the hull.
        let after = handles(&extracted.surface.mesh);
        let before = handles(&self.extracted.surface.mesh);
        if after != before && !(self.is_fused && is_simpler(&after, &before)) {
            return Err(Refusal::OtherHandles { before, after });
        }
        Ok(FairedSurface { faired, extracted })
    }
}

/// Whether a surface has as many pieces, and no more handles. Contours of several captures err against each other, so
/// that their hull may have a tunnel at a thin place; fairing fills it where all outlines bear that.
fn is_simpler(after: &[i64], before: &[i64]) -> bool {
    after.len() == before.len() && after.iter().zip(before).all(|(a, b)| a <= b)
}

/// For each piece of a mesh its handles, sorted.
fn handles(mesh: &Mesh) -> Vec<i64> {
    let pieces = components(mesh).parts;
    let mut handles: Vec<i64> = pieces.iter().map(Component::genus).collect();
    handles.sort_unstable();
    handles
}
