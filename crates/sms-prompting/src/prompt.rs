//! Prompts: the paper's structure (appendix "Baseline Implementation Details"), reworded.

/// The system message.
pub(crate) const SYSTEM: &str = "You help a flying robot to decide. It shows you what its camera sees and asks one question at a \
time: under \"Situation\" it says what it is about to do, under \"Question\" what it wants to know. Keep to the form of the answer \
that it asks for.";

fn situation(target: &str) -> String {
    let target = target.trim().replace(['"', '\n', '\r'], " ");
    let target = if target.is_empty() { "raised platform".to_owned() } else { target };
    format!(
        "Situation:\nA quadrotor is going to land on the {target} in the picture. Where it comes down it must stand safely, and \
         neither the {target} nor anything that carries it, lies on it or stands beside it may tip over or fall."
    )
}

/// Returns the question about the site.
pub(crate) fn site_question(target: &str) -> String {
    format!(
        "{}\n\nQuestion:\nIn the picture, places where it could land are marked by red circles with numbers. Which of them should \
         it take? Consider what carries each place, what could go wrong there, and where it would be safe.",
        situation(target)
    )
}

/// Returns the question about the approach.
pub(crate) fn approach_question(target: &str) -> String {
    format!(
        "{} The place is chosen already: the black dot with the white rim. What is open is the way there. The propellers blow \
         air down, which pushes on whatever the quadrotor flies over, the {} included. It should disturb as little as possible on its \
         way, and above all it must not topple what it is going to land on.\n\nQuestion:\nIn the picture, ways to that place are \
         drawn as curves of different colours, each with a number. They are drawn at the height of the landing surface: the \
         quadrotor flies a little higher, and descends at the end. Which of them should it take? Consider what each passes over, and \
         what could go wrong.",
        situation(target),
        if target.trim().is_empty() { "platform" } else { target.trim() }
    )
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
