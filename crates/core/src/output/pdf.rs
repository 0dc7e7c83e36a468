//! A small writer of PDF files: pages with black rectangles, lines and Helvetica text, exact to a ten-thousandth of a
//! point. No compression, so that a file can be read by eye.

use std::fmt::Write;

/// Points in a millimetre.
const POINTS: f64 = 72.0 / 25.4;

/// A page; positions are millimetres from its top left corner, x to the right and y down.
#[derive(Clone, Debug)]
pub(super) struct Page {
    width_mm: f64,
    height_mm: f64,
    content: String,
}

impl Page {
    /// An empty page.
    pub(super) fn new(width_mm: f64, height_mm: f64) -> Self {
        let content = "0 g 0 G\n".to_owned();
        Self {
            width_mm,
            height_mm,
            content,
        }
    }

    /// Fills rectangles, given by x, y, width and height, as one shape: no seams where they touch.
    pub(super) fn fill(&mut self, rectangles: impl IntoIterator<Item = [f64; 4]>) {
        let mut any = false;
        for [x, y, width, height] in rectangles {
            let [left, bottom] = self.point(x, y + height);
            let (width, height) = (width * POINTS, height * POINTS);
            any = true;
            let _ = writeln!(
                self.content,
                "{left:.4} {bottom:.4} {width:.4} {height:.4} re"
            );
        }
        if any {
            self.content += "f\n";
        }
    }

    /// Draws a line of a width.
    pub(super) fn line(&mut self, from: [f64; 2], to: [f64; 2], width_mm: f64) {
        let (a, b) = (self.point(from[0], from[1]), self.point(to[0], to[1]));
        let width = width_mm * POINTS;
        let _ = writeln!(
            self.content,
            "{width:.4} w {:.4} {:.4} m {:.4} {:.4} l S",
            a[0], a[1], b[0], b[1]
        );
    }

    /// Writes text of a height of letters, its first letter's foot at a place. What is not ASCII becomes `?`.
    pub(super) fn text(&mut self, at: [f64; 2], size_mm: f64, text: &str) {
        let [x, y] = self.point(at[0], at[1]);
        let size = size_mm * POINTS;
        let escaped: String = text
            .chars()
            .map(|c| match c {
                '(' | ')' | '\\' => format!("\\{c}"),
                ' '..='~' => c.to_string(),
                _ => "?".to_owned(),
            })
            .collect();
        let _ = writeln!(
            self.content,
            "BT /F1 {size:.4} Tf {x:.4} {y:.4} Td ({escaped}) Tj ET"
        );
    }

    /// A place in PDF's coordinates: points from the bottom left corner.
    fn point(&self, x: f64, y: f64) -> [f64; 2] {
        [x * POINTS, (self.height_mm - y) * POINTS]
    }
}

/// A PDF file of pages, which viewers are asked to print at their true size.
pub(super) fn pdf(title: &str, pages: &[Page]) -> Vec<u8> {
    let mut file = b"%PDF-1.4\n".to_vec();
    let mut offsets = Vec::new();
    // Objects: catalogue, tree of pages, font, information; then two for each page.
    let page_number = |k: usize| 5 + 2 * k;
    let kids: Vec<String> = (0..pages.len())
        .map(|k| format!("{} 0 R", page_number(k)))
        .collect();
    let plain: String = title
        .chars()
        .filter(|c| c.is_ascii_alphanumeric() || " :=.-_".contains(*c))
        .collect();
    let mut objects = vec![
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>".to_owned(),
        format!(
            "<< /Type /Pages /Kids [{}] /Count {} >>",
            kids.join(" "),
            pages.len()
        ),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
        format!(
            "<< /Title ({plain}) /Producer (scand {}) >>",
            env!("CARGO_PKG_VERSION")
        ),
    ];
    for (k, page) in pages.iter().enumerate() {
        objects.push(format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {:.4} {:.4}] /Contents {} 0 R /Resources << /Font << /F1 3 0 R \
             >> >> >>",
            page.width_mm * POINTS,
            page.height_mm * POINTS,
            page_number(k) + 1
        ));
        let length = page.content.len();
        objects.push(format!(
            "<< /Length {length} >>\nstream\n{}endstream",
            page.content
        ));
    }
    for (k, object) in objects.iter().enumerate() {
        offsets.push(file.len());
        file.extend(format!("{} 0 obj\n{object}\nendobj\n", k + 1).bytes());
    }
    let table = file.len();
    let count = objects.len() + 1;
    file.extend(format!("xref\n0 {count}\n0000000000 65535 f \n").bytes());
    for offset in offsets {
        file.extend(format!("{offset:010} 00000 n \n").bytes());
    }
    file.extend(
        format!(
            "trailer\n<< /Size {count} /Root 1 0 R /Info 4 0 R >>\nstartxref\n{table}\n%%EOF\n"
        )
        .bytes(),
    );
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_object_is_where_the_table_says_and_streams_are_as_long_as_they_say() {
        let mut page = Page::new(210.0, 297.0);
        page.fill([[10.0, 20.0, 30.0, 40.0]]);
        page.text([5.0, 5.0], 3.0, "a (b) \\ é");
        page.line([0.0, 0.0], [210.0, 0.0], 0.2);
        let file = pdf("board", &[page.clone(), page]);
        let text = String::from_utf8(file).unwrap();
        let table: usize = text
            .split("startxref\n")
            .nth(1)
            .unwrap()
            .lines()
            .next()
            .unwrap()
            .parse()
            .unwrap();
        let entries: Vec<&str> = text[table..].lines().skip(3).take(8).collect();
        for (k, entry) in entries.iter().enumerate() {
            let offset: usize = entry[..10].parse().unwrap();
            assert!(
                text[offset..].starts_with(&format!("{} 0 obj\n", k + 1)),
                "{entry}"
            );
            assert_eq!(entry.len(), 19, "an entry is 20 bytes with its end of line");
        }
        assert!(text.contains("/Size 9 ") && text.contains("[5 0 R 7 0 R] /Count 2"));
        let stream = text.split("stream\n").nth(1).unwrap();
        let length: usize = text
            .split("/Length ")
            .nth(1)
            .unwrap()
            .split(' ')
            .next()
            .unwrap()
            .parse()
            .unwrap();
        assert_eq!(stream.strip_suffix("end").unwrap().len(), length);
        assert!(stream.contains("(a \\(b\\) \\\\ ?) Tj"));
        // 10 mm are 28.3465 points; y counts from the bottom: 297 - 20 - 40 = 237 mm.
        assert!(
            stream.contains("28.3465 671.8110 85.0394 113.3858 re"),
            "{stream}"
        );
        assert!(text.contains("/MediaBox [0 0 595.2756 841.8898]"));
    }
}
