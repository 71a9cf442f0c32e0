//! Simple drawings on an image: text in letters of 5 × 7 dots.

use sms_core::ColorImage;

/// Width and height of a letter's cell in dots, with the space beside and below the letter.
const CELL: (usize, usize) = (6, 9);
/// The letters: bands of one line with characters and seven lines with their dots.
const LETTERS: &str = include_str!("../assets/letters.txt");

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

/// Returns width and height of the plate of a text with dots `size` pixels wide.
pub(crate) fn plate_size(text: &str, size: usize) -> (usize, usize) {
    ((CELL.0 * text.chars().count() + 1) * size, CELL.1 * size)
}

/// Draws text on a plate of `color` with dots `size` pixels wide, shifted to stay within the image.
pub(crate) fn draw_text(
    image: &mut ColorImage,
    (x, y): (usize, usize),
    text: &str,
    size: usize,
    color: [u8; 3],
) {
    let (width, height) = plate_size(text, size);
    let (x, y) = (x.min(image.width.saturating_sub(width)), y.min(image.height.saturating_sub(height)));
    let bright = color.iter().map(|&c| u32::from(c)).sum::<u32>() > 330;
    let ink = if bright { [0; 3] } else { [255; 3] };
    for j in 0..height.min(image.height - y) {
        for i in 0..width.min(image.width - x) {
            let (column, row) = (i / size, j / size);
            let is_ink = column > 0 && (1..8).contains(&row) && {
                let letter = text.chars().nth((column - 1) / CELL.0).unwrap_or(' ');
                has_ink(letter, (column - 1) % CELL.0, row - 1)
            };
            image[(x + i, y + j)] = if is_ink { ink } else { color };
        }
    }
}

/// Returns whether a letter has ink in a column and a row. Unknown characters become a box.
fn has_ink(letter: char, column: usize, row: usize) -> bool {
    let lines: Vec<&str> = LETTERS.lines().collect();
    let place = |letter: char| lines.chunks(8).find_map(|band| Some((&band[1..], band[0].find(letter)?)));
    let found = place(letter).or_else(|| place('?'));
    found.is_some_and(|(rows, at)| rows[row].as_bytes().get(CELL.0 * at + column) == Some(&b'#'))
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
    fn the_cases_of_a_letter_differ() {
        let picture = |text: &str| {
            let mut image = ColorImage::filled(7, 9, [9; 3]);
            draw_text(&mut image, (0, 0), text, 1, [255; 3]);
            image.data
        };
        let unknown = picture("\u{e9}");
        for letter in 'a'..='z' {
            let (small, large) =
                (picture(&letter.to_string()), picture(&letter.to_ascii_uppercase().to_string()));
            assert!(small != large && small != unknown && large != unknown, "{letter}");
        }
    }

    #[test]
    fn what_would_leave_the_image_is_moved_or_cut() {
        let mut image = ColorImage::filled(20, 12, [9; 3]);
        draw_text(&mut image, (19, 11), "A", 1, [255, 0, 0]);
        assert_eq!((image[(12, 3)], image[(13, 3)], image[(19, 11)]), ([9; 3], [255, 0, 0], [255, 0, 0]));
        // The text is wider than the image.
        draw_text(&mut image, (0, 0), "a long name", 1, [0, 255, 0]);
        image.draw_box((18, 10), (400, 400), 1, [0, 0, 255]);
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
