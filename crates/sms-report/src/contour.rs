//! Outlines of labelled regions, as SVG paths.

use sms_core::LabelMap;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Largest distance of a simplified outline from the pixel edges, pixels: half a step of a slanted edge, and a little more.
const TOLERANCE_PX: f64 = 0.8;
/// Smallest area of a drawn loop, pixels: a loop around a single pixel is a fault of the mask.
const LEAST_AREA_PX: f64 = 4.0;

type Corner = (i32, i32);

/// Returns the outlines of a label's region as closed loops of pixel corners; holes run the other way round.
pub(crate) fn outlines(labels: &LabelMap, label: u16) -> Vec<Vec<Corner>> {
    let inside = |x: i32, y: i32| labels.get(i64::from(x), i64::from(y)) == Some(&label);
    // Directed edges with the region on their right, by their start.
    let mut edges: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    for y in 0..labels.height as i32 {
        for x in (0..labels.width as i32).filter(|&x| inside(x, y)) {
            let sides = [
                ((x, y - 1), (x, y), (x + 1, y)),
                ((x + 1, y), (x + 1, y), (x + 1, y + 1)),
                ((x, y + 1), (x + 1, y + 1), (x, y + 1)),
                ((x - 1, y), (x, y + 1), (x, y)),
            ];
            for (neighbour, from, to) in sides {
                if !inside(neighbour.0, neighbour.1) {
                    edges.entry(from).or_default().push(to);
                }
            }
        }
    }
    let mut loops = Vec::new();
    while let Some((&start, _)) = edges.first_key_value() {
        let mut corners = vec![start];
        let mut at = start;
        while let Some(ends) = edges.get_mut(&at) {
            let Some(next) = ends.pop() else { break };
            if ends.is_empty() {
                edges.remove(&at);
            }
            at = next;
            if at == start {
                break;
            }
            corners.push(at);
        }
        if area(&corners).abs() >= LEAST_AREA_PX {
            loops.push(simplified(&corners));
        }
    }
    loops
}

/// Returns the outlines as the data of an SVG path; empty without a region.
pub(crate) fn path_data(loops: &[Vec<Corner>]) -> String {
    let mut data = String::new();
    for corners in loops {
        for (k, (x, y)) in corners.iter().enumerate() {
            let _ = write!(data, "{}{x} {y}", if k == 0 { "M" } else { "L" });
        }
        data.push('Z');
    }
    data
}

fn area(corners: &[Corner]) -> f64 {
    let next = corners.iter().skip(1).chain(corners.first());
    let twice: i64 = corners
        .iter()
        .zip(next)
        .map(|(a, b)| i64::from(a.0) * i64::from(b.1) - i64::from(b.0) * i64::from(a.1))
        .sum();
    0.5 * twice as f64
}

/// Simplifies a closed loop by the method of Douglas and Peucker, from its first corner and the one farthest from it.
fn simplified(corners: &[Corner]) -> Vec<Corner> {
    let far = (0..corners.len()).max_by_key(|&k| squared(corners[0], corners[k])).unwrap_or(0);
    let mut closed = corners.to_vec();
    closed.push(corners[0]);
    let mut kept = vec![corners[0]];
    keep(&closed[..=far], &mut kept);
    keep(&closed[far..], &mut kept);
    kept.pop();
    kept
}

fn squared(a: Corner, b: Corner) -> i64 {
    let (x, y) = (i64::from(a.0 - b.0), i64::from(a.1 - b.1));
    x * x + y * y
}

/// Appends the corners of a line that are needed after its first.
fn keep(line: &[Corner], kept: &mut Vec<Corner>) {
    let (Some(&a), Some(&b)) = (line.first(), line.last()) else { return };
    let length = (squared(a, b) as f64).sqrt();
    let distance = |p: Corner| {
        if length == 0.0 {
            return (squared(a, p) as f64).sqrt();
        }
        let cross = i64::from(b.0 - a.0) * i64::from(p.1 - a.1) - i64::from(b.1 - a.1) * i64::from(p.0 - a.0);
        cross.abs() as f64 / length
    };
    let farthest = (1..line.len().saturating_sub(1))
        .map(|k| (k, distance(line[k])))
        .max_by(|p, q| p.1.total_cmp(&q.1))
        .filter(|f| f.1 > TOLERANCE_PX);
    match farthest {
        Some((k, _)) => {
            keep(&line[..=k], kept);
            keep(&line[k..], kept);
        }
        None => kept.push(b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Image;

    fn map(rows: &[&str]) -> LabelMap {
        let data = rows.iter().flat_map(|r| r.bytes().map(|b| u16::from(b - b'0'))).collect();
        Image::from_vec(rows[0].len(), rows.len(), data)
    }

    #[test]
    fn an_outline_goes_around_its_region_and_holes_the_other_way() {
        let labels = map(&["0000000", "0111110", "0100010", "0100010", "0111110", "0000002"]);
        let loops = outlines(&labels, 1);
        let mut areas: Vec<f64> = loops.iter().map(|l| area(l)).collect();
        areas.sort_by(f64::total_cmp);
        assert_eq!(areas, [-6.0, 20.0]);
        assert!(loops.iter().all(|l| l.len() == 4), "only corners are kept: {loops:?}");
        assert!(path_data(&loops).starts_with("M1 1L"));
        // A single pixel is a fault of the mask; a label that is not there has no outline.
        assert!(outlines(&labels, 2).is_empty() && outlines(&labels, 3).is_empty());
        assert_eq!(path_data(&[]), "");
    }

    #[test]
    fn a_slanted_edge_becomes_one_line() {
        let rows: Vec<String> = (1..=8).map(|n| "1".repeat(n) + &"0".repeat(8 - n)).collect();
        let labels = map(&rows.iter().map(String::as_str).collect::<Vec<_>>());
        let loops = outlines(&labels, 1);
        assert_eq!(loops.len(), 1);
        assert!(loops[0].len() <= 5, "{:?}", loops[0]);
        assert!((area(&loops[0]) - 36.0).abs() < 5.0);
    }
}
