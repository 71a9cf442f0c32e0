//! Prompts: the paper's structure (appendix "Baseline Implementation Details"), reworded.

/// The system message.
pub(crate) const SYSTEM: &str = "You help a flying robot to decide. It shows you what its camera sees and asks one question at a \
time: under \"Situation\" it says what it is about to do, under \"Question\" what it wants to know. Keep to the form of the answer \
that it asks for.";

fn situation(target: &str) -> String {
    let target = target.trim().replace(['"', '\n', '\r'], " ");
    let target = if target.is_empty() { "raised platform".to_owned() } else { target };
    format!(include_str!("../assets/situation.txt"), target = target).trim_end().to_owned()
}

/// Returns the question about the site.
pub(crate) fn site_question(target: &str) -> String {
    format!(include_str!("../assets/sites.txt"), situation = situation(target)).trim_end().to_owned()
}

/// Returns the question about the approach.
pub(crate) fn approach_question(target: &str) -> String {
    let called = if target.trim().is_empty() { "platform" } else { target.trim() };
    let text =
        format!(include_str!("../assets/approaches.txt"), situation = situation(target), target = called);
    text.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_question_about_approaches_mentions_the_wash() {
        let (site, way) = (site_question("cardboard \"box\""), approach_question("tote"));
        let ([box_words, tote], wash) = (["cardboard  box ", "tote"], "propellers");
        assert!(site.contains(box_words) && !site.contains(wash));
        assert!(way.contains(tote) && way.contains(wash));
        assert_ne!(site_question(" "), site);
    }
}
