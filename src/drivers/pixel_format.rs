//! Pixel formats, by the names that recordings and configurations use. Each SDK's own codes for them are in that SDK's
//! folder.

use serde::{Deserialize, Serialize};

/// A pixel format.
#[derive(Deserialize, Serialize, Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Each frame is a JPEG file.
    #[serde(rename = "mjpeg")]
    Mjpeg,
    /// Red, green / green, blue.
    #[serde(rename = "bayer_rggb8")]
    BayerRggb8,
    /// Green, red / blue, green.
    #[serde(rename = "bayer_grbg8")]
    BayerGrbg8,
    /// Green, blue / red, green.
    #[serde(rename = "bayer_gbrg8")]
    BayerGbrg8,
    /// Blue, green / green, red.
    #[serde(rename = "bayer_bggr8")]
    BayerBggr8,
    /// Red, green, blue.
    #[serde(rename = "rgb8")]
    Rgb8,
    /// Blue, green, red.
    #[serde(rename = "bgr8")]
    Bgr8,
    /// Grey.
    #[serde(rename = "mono8")]
    Mono8,
    /// U, Y, V, Y.
    #[serde(rename = "uyvy")]
    Uyvy,
    /// Y, U, Y, V.
    #[serde(rename = "yuyv")]
    Yuyv,
}

impl PixelFormat {
    /// Every format.
    pub const ALL: [Self; 10] = [
        Self::Mjpeg,
        Self::BayerRggb8,
        Self::BayerGrbg8,
        Self::BayerGbrg8,
        Self::BayerBggr8,
        Self::Rgb8,
        Self::Bgr8,
        Self::Mono8,
        Self::Uyvy,
        Self::Yuyv,
    ];

    /// Its name in a recording; for a compressed format, the name of the file format.
    pub fn encoding(self) -> &'static str {
        match self {
            Self::Mjpeg => "jpeg",
            Self::BayerRggb8 => "bayer_rggb8",
            Self::BayerGrbg8 => "bayer_grbg8",
            Self::BayerGbrg8 => "bayer_gbrg8",
            Self::BayerBggr8 => "bayer_bggr8",
            Self::Rgb8 => "rgb8",
            Self::Bgr8 => "bgr8",
            Self::Mono8 => "mono8",
            Self::Uyvy => "uyvy",
            Self::Yuyv => "yuyv",
        }
    }

    /// Bytes of a pixel; `None` for a compressed format.
    pub fn bytes_per_pixel(self) -> Option<usize> {
        match self {
            Self::Mjpeg => None,
            Self::Yuyv | Self::Uyvy => Some(2),
            Self::Rgb8 | Self::Bgr8 => Some(3),
            Self::Mono8
            | Self::BayerRggb8
            | Self::BayerGrbg8
            | Self::BayerGbrg8
            | Self::BayerBggr8 => Some(1),
        }
    }
}
