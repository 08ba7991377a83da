//! Link state. How long ago did the holder of the lease renew it?

use std::time::Duration;

use zenav_protocol::messages::Link;

/// The link state for an age of the lease's last renewal; `None` (no holder) is lost.
///
/// ```
/// use std::time::Duration;
/// use zenav_edge::link::link;
/// use zenav_protocol::messages::Link;
///
/// let after = |ms| link(Some(Duration::from_millis(ms)), Duration::from_millis(500), Duration::from_secs(3));
/// assert_eq!([after(100), after(500), after(3000)], [Link::Connected, Link::Stale, Link::Lost]);
/// ```
#[must_use]
pub fn link(age: Option<Duration>, stale_after: Duration, lost_after: Duration) -> Link {
    match age {
        Some(age) if age < stale_after => Link::Connected,
        Some(age) if age < lost_after => Link::Stale,
        _ => Link::Lost,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_link_ages() {
        let at = |ms| {
            link(
                Some(Duration::from_millis(ms)),
                Duration::from_millis(500),
                Duration::from_secs(3),
            )
        };
        assert_eq!(
            (at(0), at(499), at(500), at(2999), at(3000)),
            (Link::Connected, Link::Connected, Link::Stale, Link::Stale, Link::Lost)
        );
        assert_eq!(link(None, Duration::ZERO, Duration::ZERO), Link::Lost);
    }
}
