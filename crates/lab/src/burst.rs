//! A depth camera's burst: depth frames of one scene, with their colour pictures. The caller decides whether the
//! scene is an object or a board.

use super::color::expose;
use super::depth::{DepthScene, picture};
use super::options::ColorSensor;
use super::render::Rendered;
use super::{DepthStation, Options};
use rayon::prelude::*;
use scand_core::frame::{Frame, Stream, Timestamp};
use scand_core::image::Grid;

/// Nanoseconds between two frames.
pub(super) const DEPTH_PERIOD: u64 = 33_333_333;

/// The inputs for a burst.
pub(super) struct Burst<'a> {
    pub options: &'a Options,
    pub station: &'a DepthStation,
    /// The depth camera's number.
    pub camera: u64,
    /// What its depth sees, its colour sees, and how.
    pub scene: &'a DepthScene,
    pub rendered: &'a Rendered,
    pub sensor: &'a ColorSensor,
    /// The capture's number.
    pub capture: usize,
    /// When the first frame's exposure begins, in UTC nanoseconds.
    pub start: u64,
    /// Tells the pictures' noise from that of all else.
    pub noise: u64,
}

impl Burst<'_> {
    /// Its frames in the order of their times; with each colour picture the depth that it belongs to.
    pub(super) fn frames(&self) -> Vec<Frame> {
        let count = self.options.depth.frames;
        let frames = (0..count).into_par_iter();
        frames.flat_map_iter(|i| self.frame(i)).collect()
    }

    fn frame(&self, i: usize) -> impl Iterator<Item = Frame> {
        let Options { seed, depth, .. } = self.options;
        let camera = &self.station.actual.camera;
        let timestamp = Timestamp(self.start + DEPTH_PERIOD * i as u64);
        let number = (self.capture * depth.frames + i) as u64;
        let frame = |stream, picture| Frame {
            camera: camera.id.clone(),
            stream,
            timestamp,
            picture,
        };
        let readings = match self.options.faults.no_depth {
            true => Grid::filled(camera.intrinsics.width, camera.intrinsics.height, 0),
            false => self
                .scene
                .read(self.options, self.station, self.camera, number),
        };
        let key = [*seed, self.noise, self.camera, number];
        let color = i.is_multiple_of(depth.color_every.max(1)).then(|| {
            let picture = expose(self.rendered, self.sensor, [1.0; 3], key);
            frame(Stream::DepthColor, picture)
        });
        color
            .into_iter()
            .chain([frame(Stream::Depth, picture(&readings))])
    }
}
