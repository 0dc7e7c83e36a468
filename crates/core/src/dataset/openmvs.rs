//! OpenMVS's `scene.mvs`: its interface file (`MVSI`, version 5). Each camera is a platform of its own. As in scand, a
//! pixel's centre is at whole numbers.

use super::points::Point;
use super::undistort::View;
use super::{File, Kind};
use nalgebra::{Matrix3, Matrix4, Vector3};

const VERSION: u32 = 5;
/// No identity of its own.
const NO_ID: u32 = u32::MAX;

/// The file that describes the pictures.
pub(super) fn describe(views: &[View], points: &[Point]) -> Vec<File> {
    let mut scene = Archive::default();
    scene.bytes.extend(b"MVSI");
    scene.half(VERSION);
    scene.half(0);
    scene.length(views.len());
    views.iter().for_each(|view| scene.platform(view));
    scene.length(views.len());
    for (number, view) in (0..).zip(views) {
        scene.image(view, number);
    }
    scene.points(points);
    // No lines, nor their normals and colours.
    (0..3).for_each(|_| scene.length(0));
    scene.doubles(Matrix4::<f64>::identity().iter());
    vec![File {
        path: "scene.mvs".into(),
        bytes: scene.bytes,
    }]
}

/// Numbers as OpenMVS writes them: little endian, lengths of 8 bytes.
#[derive(Default)]
struct Archive {
    bytes: Vec<u8>,
}

impl Archive {
    fn half(&mut self, number: u32) {
        self.bytes.extend(number.to_le_bytes());
    }

    fn length(&mut self, number: usize) {
        self.bytes.extend((number as u64).to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.length(text.len());
        self.bytes.extend(text.as_bytes());
    }

    fn doubles<'a>(&mut self, numbers: impl Iterator<Item = &'a f64>) {
        self.bytes.extend(numbers.flat_map(|n| n.to_le_bytes()));
    }

    fn floats(&mut self, vector: Vector3<f64>) {
        let floats = vector.iter().flat_map(|n| (*n as f32).to_le_bytes());
        self.bytes.extend(floats);
    }

    /// A camera at the platform's place, and the platform's one pose.
    fn platform(&mut self, view: &View) {
        let camera = &view.pinhole;
        let (f, c) = (camera.focal_px, camera.center_px);
        self.text(view.camera.as_str());
        self.length(1);
        self.text(view.camera.as_str());
        // The band's name.
        self.text("");
        self.half(camera.width as u32);
        self.half(camera.height as u32);
        self.rows(&Matrix3::new(f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0));
        self.rows(&Matrix3::identity());
        self.doubles([0.0; 3].iter());
        self.length(1);
        let camera_from_rig = view.rig_from_camera.rotation.inverse();
        self.rows(camera_from_rig.to_rotation_matrix().matrix());
        self.doubles(view.rig_from_camera.translation.vector.iter());
    }

    fn rows(&mut self, matrix: &Matrix3<f64>) {
        // Rows of the matrix are columns of its transpose, which lie one after the other.
        self.doubles(matrix.transpose().iter());
    }

    fn image(&mut self, view: &View, number: u32) {
        let name = view.picture_name();
        self.text(&format!("images/{name}"));
        let mask = view.mask.is_some();
        let mask = mask.then(|| format!("masks/{}", Kind::OpenMvs.mask_name(&name)));
        self.text(&mask.unwrap_or_default());
        for id in [number, 0, 0, NO_ID] {
            self.half(id);
        }
    }

    fn points(&mut self, points: &[Point]) {
        self.length(points.len());
        for point in points {
            self.floats(point.position.coords);
            self.length(point.seen.len());
            for (view, _) in &point.seen {
                self.half(*view as u32);
                // No confidence.
                self.half(0);
            }
        }
        self.length(points.len());
        points.iter().for_each(|point| self.floats(point.normal));
        self.length(points.len());
        for point in points {
            let [r, g, b] = point.color;
            self.bytes.extend([b, g, r]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::points;
    use super::super::testing::{ball, two_views};
    use super::*;
    use nalgebra::Point3;

    struct Reader<'a>(&'a [u8]);

    impl Reader<'_> {
        fn take(&mut self, count: usize) -> Vec<u8> {
            let (head, rest) = self.0.split_at(count);
            self.0 = rest;
            head.to_vec()
        }

        fn half(&mut self) -> u32 {
            u32::from_le_bytes(self.take(4).try_into().unwrap())
        }

        fn length(&mut self) -> usize {
            u64::from_le_bytes(self.take(8).try_into().unwrap()) as usize
        }

        fn text(&mut self) -> String {
            let length = self.length();
            String::from_utf8(self.take(length)).unwrap()
        }

        fn doubles<const N: usize>(&mut self) -> [f64; N] {
            std::array::from_fn(|_| f64::from_le_bytes(self.take(8).try_into().unwrap()))
        }

        fn float(&mut self) -> f64 {
            f64::from(f32::from_le_bytes(self.take(4).try_into().unwrap()))
        }
    }

    #[test]
    fn a_reader_of_the_file_projects_points_where_the_calibration_does() {
        let views = two_views();
        let points = points(&ball(), &views);
        let bytes = describe(&views, &points).remove(0).bytes;
        let mut reader = Reader(&bytes);
        assert_eq!(reader.take(4), b"MVSI");
        assert_eq!([reader.half(), reader.half()], [5, 0]);
        assert_eq!(reader.length(), 2);
        let mut cameras = Vec::new();
        for view in &views {
            assert_eq!(reader.text(), view.camera.as_str());
            assert_eq!(reader.length(), 1);
            assert_eq!([reader.text(), reader.text()], [view.camera.as_str(), ""]);
            assert_eq!([reader.half(), reader.half()], [240, 180]);
            let k = Matrix3::from_row_slice(&reader.doubles::<9>());
            let (own_r, own_c) = (reader.doubles::<9>(), reader.doubles::<3>());
            assert_eq!((own_r[0], own_r[1], own_c), (1.0, 0.0, [0.0; 3]));
            assert_eq!(reader.length(), 1);
            let r = Matrix3::from_row_slice(&reader.doubles::<9>());
            cameras.push((k, r, Point3::from(reader.doubles::<3>())));
        }
        assert_eq!(reader.length(), 2);
        for (number, view) in (0..).zip(&views) {
            let name = view.picture_name();
            assert_eq!(
                [reader.text(), reader.text()],
                [format!("images/{name}"), format!("masks/{name}")]
            );
            assert_eq!(
                [reader.half(), reader.half(), reader.half(), reader.half()],
                [number, 0, 0, NO_ID]
            );
        }
        assert_eq!(reader.length(), points.len());
        for point in &points {
            let x = Point3::new(reader.float(), reader.float(), reader.float());
            assert_eq!(reader.length(), 2);
            for (view, pixel) in &point.seen {
                assert_eq!((reader.half() as usize, reader.half()), (*view, 0));
                let (k, r, c) = &cameras[*view];
                let p = k * (r * (x - c));
                assert!((p.x / p.z - pixel.x).hypot(p.y / p.z - pixel.y) < 0.1);
            }
        }
        // Normals, colours, three empty lists and a matrix are left.
        assert_eq!(
            reader.0.len(),
            8 + 12 * points.len() + 8 + 3 * points.len() + 24 + 128
        );
    }
}
