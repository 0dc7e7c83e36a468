//! USDZ: a package of OpenUSD with the scene as text and the texture as PNG. Metres (`metersPerUnit = 1`), y up;
//! entries are stored and lie at multiples of 64 bytes, as the format requires.

use super::zip::{self, Entry};
use super::{Error, known, unique_uv};
use crate::description::{Description, clean};
use crate::mesh::bounding_box;
use crate::output::{encode_png, unit, y_up};
use crate::reconstruct::Model;
use nalgebra::Point3;
use std::fmt::{Display, Write};

/// A model as the bytes of a .usdz.
///
/// # Errors
/// If the texture cannot be encoded, or the package is too large.
pub(super) fn encode(model: &Model, about: &Description) -> Result<Vec<u8>, Error> {
    let atlas = model.texture.as_ref().map(|t| encode_png(&t.atlas));
    let atlas = atlas.transpose()?;
    let scene = scene(model, about);
    let entry = |name, bytes| Entry {
        name,
        bytes,
        deflate: false,
    };
    let mut entries = vec![entry("model.usda", scene.as_bytes())];
    if let Some(atlas) = &atlas {
        entries.push(entry("textures/atlas.png", atlas));
    }
    zip::pack(&entries, 64, "USDZ")
}

fn scene(model: &Model, about: &Description) -> String {
    let mut usda = String::from("#usda 1.0\n(\n");
    usda.push_str("    customLayerData = {\n");
    for (name, text) in about.pairs() {
        if let Some(text) = clean(text) {
            let _ = writeln!(usda, "        string {name} = {}", quoted(&text));
        }
    }
    usda.push_str("    }\n    defaultPrim = \"Model\"\n");
    let _ = writeln!(usda, "    doc = {}", quoted(&known(about).join("; ")));
    usda.push_str("    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\n");
    let _ = writeln!(
        usda,
        "def Xform \"Model\" (\n    displayName = {}\n    kind = \"component\"\n)\n{{",
        quoted(&clean(&about.heading()).unwrap_or_default())
    );
    push_surface(&mut usda, model);
    usda.push_str(match model.texture {
        Some(_) => TEXTURED,
        None => GREY,
    });
    usda.push_str("}\n");
    usda
}

fn push_surface(usda: &mut String, model: &Model) {
    usda.push_str(
        "    def Mesh \"Surface\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {\n",
    );
    let mesh = &model.mesh;
    let points: Vec<Point3<f32>> = mesh
        .vertices
        .iter()
        .map(|p| y_up((*p).into()).into())
        .collect();
    if let Some(corners) = bounding_box(&points) {
        let corners = corners.iter().map(|p| tuple((*p).into()));
        push(usda, "float3[] extent", corners, "");
    }
    let counts = mesh.triangles.iter().map(|_| 3);
    push(usda, "int[] faceVertexCounts", counts, "");
    push(
        usda,
        "int[] faceVertexIndices",
        mesh.triangles.iter().flatten(),
        "",
    );
    let normals = model.normals.iter().map(|n| tuple(y_up(unit(*n).into())));
    push(usda, "normal3f[] normals", normals, "vertex");
    push(
        usda,
        "point3f[] points",
        points.iter().map(|p| tuple((*p).into())),
        "",
    );
    if let Some(texture) = &model.texture {
        let (places, corners) = unique_uv(texture);
        // Up from the bottom edge.
        let places = places.iter().map(|[u, v]| tuple([*u, 1.0 - v]));
        push(usda, "texCoord2f[] primvars:st", places, "faceVarying");
        push(
            usda,
            "int[] primvars:st:indices",
            corners.iter().flatten(),
            "",
        );
    }
    let provenance = model.provenance.iter().map(|p| *p as u8);
    push(usda, "int[] primvars:provenance", provenance, "vertex");
    let errors = model.expected_error.iter();
    push(usda, "float[] primvars:expectedError", errors, "vertex");
    usda.push_str("        uniform token subdivisionScheme = \"none\"\n        rel material:binding = </Model/Material>\n    }\n\n");
}

/// Appends an attribute that is an array.
fn push(
    usda: &mut String,
    declaration: &str,
    values: impl Iterator<Item = impl Display>,
    interpolation: &str,
) {
    let _ = write!(usda, "        {declaration} = [");
    for (i, value) in values.enumerate() {
        let comma = if i == 0 { "" } else { ", " };
        let _ = write!(usda, "{comma}{value}");
    }
    usda.push(']');
    if !interpolation.is_empty() {
        let _ = write!(
            usda,
            " (\n            interpolation = \"{interpolation}\"\n        )"
        );
    }
    usda.push('\n');
}

fn tuple<const N: usize>(values: [f32; N]) -> String {
    format!("({})", values.map(|v| v.to_string()).join(", "))
}

/// A text of one line as a string of USD.
fn quoted(text: &str) -> String {
    let escaped = text.replace('\\', "\\\\").replace('"', "\\\"");
    format!("\"{escaped}\"")
}

const TEXTURED: &str = r#"    def Material "Material"
    {
        token outputs:surface.connect = </Model/Material/Shader.outputs:surface>

        def Shader "Shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </Model/Material/Texture.outputs:rgb>
            float inputs:metallic = 0
            float inputs:roughness = 1
            token outputs:surface
        }

        def Shader "Texture"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @textures/atlas.png@
            token inputs:sourceColorSpace = "sRGB"
            float2 inputs:st.connect = </Model/Material/Places.outputs:result>
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }

        def Shader "Places"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }
    }
"#;

const GREY: &str = r#"    def Material "Material"
    {
        token outputs:surface.connect = </Model/Material/Shader.outputs:surface>

        def Shader "Shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.6, 0.6, 0.6)
            float inputs:metallic = 0
            float inputs:roughness = 1
            token outputs:surface
        }
    }
"#;

#[cfg(test)]
mod tests {
    use super::super::testing::{described, textured_square};
    use super::*;

    #[test]
    fn a_title_is_one_line_wherever_it_stands() {
        let about = Description {
            title: Some("a\nkrater\u{1b}".into()),
            ..described("a")
        };
        let usda = scene(&textured_square(), &about);
        assert!(
            usda.contains("displayName = \"1884.3, a krater  (a)\""),
            "{usda}"
        );
        assert!(!usda.contains('\u{1b}'));
        let name = usda
            .lines()
            .find(|line| line.contains("displayName"))
            .unwrap();
        assert_eq!(name.matches('"').count(), 2, "{name}");
    }

    #[test]
    fn the_scene_is_in_metres_with_y_up_and_its_texts_stay_texts() {
        let mut about = described("a");
        about.title = Some("a \"cup\" \\ \n)".into());
        let usda = scene(&textured_square(), &about);
        assert!(usda.contains("metersPerUnit = 1") && usda.contains("upAxis = \"Y\""));
        assert!(
            usda.contains(r#"string title = "a \"cup\" \\  )""#),
            "{usda}"
        );
        assert!(usda.contains(
            "point3f[] points = [(0, 0.25, 0), (1, 0.25, 0), (1, 0.25, -1), (0, 0.25, -1)]"
        ));
        assert!(
            usda.contains("float3[] extent = [(0, 0.25, -1), (1, 0.25, 0)]"),
            "{usda}"
        );
        assert!(usda.contains("int[] primvars:provenance = [0, 5, 1, 2]"));
        assert_eq!(usda.matches('{').count(), usda.matches('}').count());
    }

    #[test]
    fn the_package_begins_with_the_scene_at_a_multiple_of_64() {
        let bytes = encode(&textured_square(), &described("a")).unwrap();
        let half = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let data = 30 + half(26) + half(28);
        assert_eq!((&bytes[30..40], data % 64), (&b"model.usda"[..], 0));
        assert_eq!(half(8), 0, "stored");
        assert!(bytes[data..].starts_with(b"#usda 1.0"));
    }
}
