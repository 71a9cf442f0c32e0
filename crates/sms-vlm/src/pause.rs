//! Pauses between attempts of a request.

use rand::RngExt;
use sms_core::{Cancel, CoreError, Seed};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A way to wait. Tests only record the duration.
pub trait Pause: Send + Sync {
    /// Waits for a time in seconds, or until cancellation.
    ///
    /// # Errors
    /// [`CoreError::Interrupted`].
    fn pause(&self, seconds: f64, cancel: &Cancel) -> Result<(), CoreError>;
}

/// Waits in small steps, so that Ctrl-C takes effect.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sleep;

/// Longest delay of a cancellation.
pub(crate) const STEP: Duration = Duration::from_millis(25);

impl Pause for Sleep {
    fn pause(&self, seconds: f64, cancel: &Cancel) -> Result<(), CoreError> {
        let end = Instant::now() + Duration::from_secs_f64(seconds.clamp(0.0, 86_400.0));
        loop {
            cancel.check()?;
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(());
            }
            std::thread::sleep(left.min(STEP));
        }
    }
}

/// Returns the seconds before attempt `attempt` (from 1): the server's `Retry-After`, else `first` doubled each
/// time, less a random part of up to a half so that several clients do not return at once; at most `longest`.
pub(crate) fn seconds_before(
    attempt: usize,
    server: Option<Duration>,
    first: f64,
    longest: f64,
    seed: Seed,
) -> f64 {
    let jitter: f64 = seed.derive_index("attempt", attempt as u64).rng().random();
    let own = first * 2f64.powi(attempt.saturating_sub(1).min(30) as i32) * (1.0 - 0.5 * jitter);
    match server {
        // Never earlier than `Retry-After`.
        Some(wait) => (wait.as_secs_f64() + 0.1 * first * jitter).min(longest),
        None => own.min(longest),
    }
}

/// Parses the header `Retry-After`: seconds, or a date (0 if it has passed). `None` for anything else.
pub(crate) fn retry_after(text: &str, now: SystemTime) -> Option<Duration> {
    let text = text.trim();
    if let Ok(seconds) = text.parse::<f64>() {
        return (0.0..1e9).contains(&seconds).then(|| Duration::from_secs_f64(seconds));
    }
    let then = http_date(text)?;
    let now = now.duration_since(UNIX_EPOCH).ok()?.as_secs_f64();
    Some(Duration::from_secs_f64((then - now).clamp(0.0, 1e9)))
}

/// Returns the seconds since 1970 of a date in one of the three forms of HTTP: `Sun, 06 Nov 1994 08:49:37 GMT`,
/// `Sunday, 06-Nov-94 08:49:37 GMT`, `Sun Nov  6 08:49:37 1994`.
fn http_date(text: &str) -> Option<f64> {
    const MONTHS: [&str; 12] =
        ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];
    let text = text.to_ascii_lowercase();
    let words: Vec<&str> = text.split([' ', ',', '-']).filter(|w| !w.is_empty() && *w != "gmt").collect();
    let [_, a, b, c, d] = words[..] else { return None };
    let month_of = |word: &str| MONTHS.iter().position(|m| *m == word);
    let (day, month, year, time) = match month_of(a) {
        Some(month) => (b, month, d, c),
        None => (a, month_of(b)?, c, d),
    };
    let day: i64 = day.parse().ok().filter(|d| (1..=31).contains(d))?;
    let year: i64 = year.parse().ok().filter(|y| (0..=9999).contains(y))?;
    let year = match year {
        0..70 => year + 2000,
        70..100 => year + 1900,
        _ => year,
    };
    let clock: Vec<i64> = time.split(':').map(|t| t.parse().ok()).collect::<Option<_>>()?;
    let [hour, minute, second] = clock[..] else { return None };
    if !((0..24).contains(&hour) && (0..60).contains(&minute) && (0..=60).contains(&second)) {
        return None;
    }
    // Days since 1970, counting years from March so that the leap day is the last.
    let (y, m) = if month < 2 { (year - 1, month as i64 + 10) } else { (year, month as i64 - 2) };
    let days = 365 * y + y.div_euclid(4) - y.div_euclid(100) + y.div_euclid(400) + (153 * m + 2) / 5 + day
        - 1
        - 719_468;
    Some((days * 86_400 + hour * 3600 + minute * 60 + second) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_of_all_three_forms_are_the_same_time() {
        for text in
            ["Sun, 06 Nov 1994 08:49:37 GMT", "Sunday, 06-Nov-94 08:49:37 GMT", "Sun Nov  6 08:49:37 1994"]
        {
            assert_eq!(http_date(text), Some(784_111_777.0), "{text}");
        }
        assert_eq!(http_date("Thu, 29 Feb 2024 00:00:00 GMT"), Some(1_709_164_800.0));
        assert_eq!(http_date("Thu, 01 Jan 1970 00:00:00 GMT"), Some(0.0));
        for wrong in [
            "",
            "soon",
            "Sun, 06 Non 1994 08:49:37 GMT",
            "Sun, 06 Nov 1994 08:49 GMT",
            "Sun, 40 Nov 1994 08:49:37",
        ] {
            assert_eq!(http_date(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn the_header_is_seconds_or_a_date() {
        let now = UNIX_EPOCH + Duration::from_secs(784_111_770);
        let seconds = |text: &str| retry_after(text, now).map(|d| d.as_secs_f64());
        assert_eq!(seconds("7"), Some(7.0));
        assert_eq!(seconds(" 0.5 "), Some(0.5));
        assert_eq!(seconds("Sun, 06 Nov 1994 08:49:37 GMT"), Some(7.0));
        assert_eq!(seconds("Sun, 06 Nov 1994 08:49:00 GMT"), Some(0.0), "it has passed");
        for wrong in ["-1", "nan", "inf", "1e400", "later"] {
            assert_eq!(seconds(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn pauses_double_with_jitter_and_have_an_end() {
        let before = |attempt, server| seconds_before(attempt, server, 1.0, 20.0, Seed(3));
        for attempt in 1..=4 {
            let most = f64::from(1 << (attempt - 1));
            let pause = before(attempt as usize, None);
            assert!((0.5 * most..=most).contains(&pause), "{attempt}: {pause}");
            assert_eq!(pause, before(attempt as usize, None), "the same seed, the same pause");
        }
        assert_eq!(before(200, None), 20.0);
        let told = before(1, Some(Duration::from_secs(7)));
        assert!((7.0..=7.1).contains(&told), "{told}");
        assert_eq!(before(1, Some(Duration::from_secs(4000))), 20.0);
    }

    #[test]
    fn a_stop_ends_the_pause() {
        let cancel = Cancel::new();
        cancel.cancel();
        assert!(matches!(Sleep.pause(1e6, &cancel), Err(CoreError::Interrupted)));
    }
}
