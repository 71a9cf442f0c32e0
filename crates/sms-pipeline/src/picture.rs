//! Simple drawings on an image: boxes, and text in letters of 5 × 7 dots.

use sms_core::ColorImage;

/// Width and height of a letter's cell in dots, with the space beside and below the letter.
const CELL: (usize, usize) = (6, 9);

/// Enlarges an image by an integer `factor`.
pub(crate) fn enlarged(image: &ColorImage, factor: usize) -> ColorImage {
    let mut out = ColorImage::filled(image.width * factor, image.height * factor, [0; 3]);
    for y in 0..out.height {
        for x in 0..out.width {
            out[(x, y)] = image[(x / factor, y / factor)];
        }
    }
    out
}

/// Draws the outline of a box from `(x0, y0)` to `(x1, y1)`, `thick` pixels wide, clamped to the image.
pub(crate) fn draw_box(
    image: &mut ColorImage,
    (x0, y0): (usize, usize),
    (x1, y1): (usize, usize),
    thick: usize,
    color: [u8; 3],
) {
    let (x1, y1) = (x1.min(image.width), y1.min(image.height));
    for y in y0..y1 {
        for x in x0..x1 {
            if x < x0 + thick || y < y0 + thick || x + thick >= x1 || y + thick >= y1 {
                image[(x, y)] = color;
            }
        }
    }
}

/// Draws text on a plate of `color` with dots `size` pixels wide, shifted to stay within the image.
pub(crate) fn draw_text(
    image: &mut ColorImage,
    (x, y): (usize, usize),
    text: &str,
    size: usize,
    color: [u8; 3],
) {
    let (width, height) = ((CELL.0 * text.chars().count() + 1) * size, CELL.1 * size);
    let (x, y) = (x.min(image.width.saturating_sub(width)), y.min(image.height.saturating_sub(height)));
    let bright = color.iter().map(|&c| u32::from(c)).sum::<u32>() > 330;
    let ink = if bright { [0; 3] } else { [255; 3] };
    for j in 0..height.min(image.height - y) {
        for i in 0..width.min(image.width - x) {
            let (column, row) = (i / size, j / size);
            let is_ink = column > 0 && row > 0 && {
                let letter = text.chars().nth((column - 1) / CELL.0).unwrap_or(' ');
                let dots = dots(letter).get((column - 1) % CELL.0).copied().unwrap_or(0);
                row < 8 && dots >> (row - 1) & 1 == 1
            };
            image[(x + i, y + j)] = if is_ink { ink } else { color };
        }
    }
}

/// Returns the columns of a letter, lowest bit on top. Lower-case letters become upper-case; unknown characters become
/// a box.
fn dots(letter: char) -> [u8; 5] {
    match letter.to_ascii_uppercase() {
        ' ' => [0; 5],
        '%' => [0x23, 0x13, 0x08, 0x64, 0x62],
        '-' => [0x08; 5],
        '.' => [0x00, 0x60, 0x60, 0x00, 0x00],
        '_' => [0x40; 5],
        '0' => [0x3e, 0x51, 0x49, 0x45, 0x3e],
        '1' => [0x00, 0x42, 0x7f, 0x40, 0x00],
        '2' => [0x42, 0x61, 0x51, 0x49, 0x46],
        '3' => [0x21, 0x41, 0x45, 0x4b, 0x31],
        '4' => [0x18, 0x14, 0x12, 0x7f, 0x10],
        '5' => [0x27, 0x45, 0x45, 0x45, 0x39],
        '6' => [0x3c, 0x4a, 0x49, 0x49, 0x30],
        '7' => [0x01, 0x71, 0x09, 0x05, 0x03],
        '8' => [0x36, 0x49, 0x49, 0x49, 0x36],
        '9' => [0x06, 0x49, 0x49, 0x29, 0x1e],
        'A' => [0x7e, 0x11, 0x11, 0x11, 0x7e],
        'B' => [0x7f, 0x49, 0x49, 0x49, 0x36],
        'C' => [0x3e, 0x41, 0x41, 0x41, 0x22],
        'D' => [0x7f, 0x41, 0x41, 0x22, 0x1c],
        'E' => [0x7f, 0x49, 0x49, 0x49, 0x41],
        'F' => [0x7f, 0x09, 0x09, 0x09, 0x01],
        'G' => [0x3e, 0x41, 0x49, 0x49, 0x7a],
        'H' => [0x7f, 0x08, 0x08, 0x08, 0x7f],
        'I' => [0x00, 0x41, 0x7f, 0x41, 0x00],
        'J' => [0x20, 0x40, 0x41, 0x3f, 0x01],
        'K' => [0x7f, 0x08, 0x14, 0x22, 0x41],
        'L' => [0x7f, 0x40, 0x40, 0x40, 0x40],
        'M' => [0x7f, 0x02, 0x0c, 0x02, 0x7f],
        'N' => [0x7f, 0x04, 0x08, 0x10, 0x7f],
        'O' => [0x3e, 0x41, 0x41, 0x41, 0x3e],
        'P' => [0x7f, 0x09, 0x09, 0x09, 0x06],
        'Q' => [0x3e, 0x41, 0x51, 0x21, 0x5e],
        'R' => [0x7f, 0x09, 0x19, 0x29, 0x46],
        'S' => [0x46, 0x49, 0x49, 0x49, 0x31],
        'T' => [0x01, 0x01, 0x7f, 0x01, 0x01],
        'U' => [0x3f, 0x40, 0x40, 0x40, 0x3f],
        'V' => [0x1f, 0x20, 0x40, 0x20, 0x1f],
        'W' => [0x3f, 0x40, 0x38, 0x40, 0x3f],
        'X' => [0x63, 0x14, 0x08, 0x14, 0x63],
        'Y' => [0x07, 0x08, 0x70, 0x08, 0x07],
        'Z' => [0x61, 0x51, 0x49, 0x45, 0x43],
        _ => [0x7f, 0x41, 0x41, 0x41, 0x7f],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_stand_upright_and_read_from_the_left() {
        let mut image = ColorImage::filled(13, 9, [9; 3]);
        draw_text(&mut image, (0, 0), "L1", 1, [255; 3]);
        let rows: Vec<String> = (1..8)
            .map(|y| (1..13).map(|x| if image[(x, y)] == [0; 3] { '#' } else { '.' }).collect())
            .collect();
        let expected = [
            "#.......#...",
            "#......##...",
            "#.......#...",
            "#.......#...",
            "#.......#...",
            "#.......#...",
            "#####..###..",
        ];
        assert_eq!(rows, expected);
    }

    #[test]
    fn what_would_leave_the_image_is_moved_or_cut() {
        let mut image = ColorImage::filled(20, 12, [9; 3]);
        draw_text(&mut image, (19, 11), "a", 1, [255, 0, 0]);
        assert_eq!((image[(12, 3)], image[(13, 3)], image[(19, 11)]), ([9; 3], [255, 0, 0], [255, 0, 0]));
        // The text is wider than the image.
        draw_text(&mut image, (0, 0), "a long name", 1, [0, 255, 0]);
        draw_box(&mut image, (18, 10), (400, 400), 1, [0, 0, 255]);
        assert_eq!(
            (image[(17, 10)], image[(18, 10)], image[(19, 11)]),
            ([255, 0, 0], [0, 0, 255], [0, 0, 255])
        );
    }

    #[test]
    fn an_enlarged_image_repeats_its_pixels() {
        let image = ColorImage::from_vec(2, 1, vec![[1; 3], [2; 3]]);
        let large = enlarged(&image, 2);
        assert_eq!((large.size(), large.data), ((4, 2), [[1; 3], [1; 3], [2; 3], [2; 3]].repeat(2)));
    }
}
