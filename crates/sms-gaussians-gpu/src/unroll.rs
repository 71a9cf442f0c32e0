//! Unrolling of loops in the text of kernels. Some compilers do not unroll a loop over an array of registers and keep
//! the array in memory, which costs the segmentation more than all its arithmetic.
//!
//! `//unroll k CLASSES` … `//end` repeats the lines in between for k = 0, 1, …, with `$k` replaced by the number. The
//! count is a number or one of the given names.

/// Expands all unrolled loops of a kernel.
///
/// # Panics
/// If a loop has no end, no count, or an unknown count: the kernels are part of the program.
pub(crate) fn unroll(text: &str, counts: &[(&str, usize)]) -> String {
    let mut lines = text.lines();
    let out = expand(&mut lines, counts, false);
    assert!(lines.next().is_none(), "every loop of a kernel has one end");
    out
}

fn expand(lines: &mut std::str::Lines<'_>, counts: &[(&str, usize)], inside: bool) -> String {
    let mut out = String::new();
    while let Some(line) = lines.next() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("//unroll") => {
                let (name, count) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
                let known = counts.iter().find(|(n, _)| *n == count).map(|(_, c)| *c);
                let count = known.or_else(|| count.parse().ok()).expect("a loop has a known count");
                let body = expand(lines, counts, true);
                let variable = format!("${name}");
                (0..count).for_each(|i| out.push_str(&body.replace(&variable, &i.to_string())));
            }
            Some("//end") => {
                assert!(inside, "an end has a loop");
                return out;
            }
            _ => {
                out.push_str(line);
                out.push('\n');
            }
        }
    }
    assert!(!inside, "every loop of a kernel has an end");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loops_are_written_out_from_the_inside() {
        let text = "a\n//unroll i N\n//unroll k 2\nx$i += $ku;\n//end\ny$i;\n//end\nb";
        let expected = "a\nx0 += 0u;\nx0 += 1u;\ny0;\nx1 += 0u;\nx1 += 1u;\ny1;\nb\n";
        assert_eq!(unroll(text, &[("N", 2)]), expected);
        assert_eq!(unroll("a\n//unroll i 0\nb\n//end", &[]), "a\n");
    }

    #[test]
    #[should_panic = "has an end"]
    fn a_loop_without_an_end_is_refused() {
        unroll("//unroll i 2\nx", &[]);
    }
}
