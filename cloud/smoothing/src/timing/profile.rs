//! Velocity profile. A motion from rest to rest, or to rest, with limited acceleration and jerk: up to seven pieces of constant jerk.
//!
//! Without a jerk limit the acceleration jumps: the speed is a trapezoid.
//!
//! Source: Biagiotti and Melchiorri, "Trajectory Planning for Automatic Machines and Robots", 2008, the double S velocity profile.

/// Limits of a profile, in m or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProfileLimits {
    /// Speed, 1/s.
    pub speed: f64,
    /// Acceleration, 1/s².
    pub acceleration: f64,
    /// Jerk, 1/s³; `None`: the acceleration jumps.
    pub jerk: Option<f64>,
}

/// Motion along one axis over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    pieces: Vec<Piece>,
    duration: f64,
}

/// Constant jerk from a time on.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    begin: f64,
    distance: f64,
    v: f64,
    a: f64,
    jerk: f64,
}

/// A phase of a profile: duration, acceleration at its beginning, jerk.
type Phase = (f64, f64, f64);

impl Profile {
    /// From rest to rest, `distance` (not negative) away, as fast as the limits allow.
    #[must_use]
    pub fn rest_to_rest(distance: f64, limits: &ProfileLimits) -> Self {
        let ProfileLimits {
            speed,
            acceleration,
            jerk,
        } = *limits;
        // The peak speed if there is no time to hold it: half the distance to gain it, half to lose it.
        let ramps = jerk.map_or(0.0, |jerk| acceleration * acceleration / jerk);
        let full = 0.5 * ((ramps * ramps + 4.0 * acceleration * distance).sqrt() - ramps);
        let reached = match jerk {
            Some(jerk) if full < ramps => (0.25 * distance * distance * jerk).cbrt(),
            _ => full,
        };
        let top = reached.min(speed);
        let [gain, lose] = [change(top, 1.0, limits), change(top, -1.0, limits)];
        let gaining: f64 = gain.iter().map(|(duration, _, _)| duration).sum();
        let keep = (distance / top - gaining, 0.0, 0.0);
        Self::of(0.0, &[&gain[..], &[keep], &lose].concat())
    }

    /// From a speed (not negative) to rest.
    #[must_use]
    pub fn to_rest(speed: f64, limits: &ProfileLimits) -> Self {
        Self::of(speed, &change(speed, -1.0, limits))
    }

    fn of(speed: f64, phases: &[Phase]) -> Self {
        let mut profile = Self::default();
        let (mut distance, mut v) = (0.0, speed);
        for &(duration, a, jerk) in phases {
            if duration.is_nan() || duration <= 1e-12 {
                continue;
            }
            let begin = profile.duration;
            let piece = Piece {
                begin,
                distance,
                v,
                a,
                jerk,
            };
            (distance, v, _) = piece.at(duration);
            profile.pieces.push(piece);
            profile.duration += duration;
        }
        profile
    }

    /// Duration, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// The whole distance.
    #[must_use]
    pub fn distance(&self) -> f64 {
        self.at(self.duration).0
    }

    /// Times at which acceleration or jerk jump, s: the beginning included, the end not.
    pub fn breaks(&self) -> impl Iterator<Item = f64> + '_ {
        self.pieces.iter().map(|piece| piece.begin)
    }

    /// Distance, speed and acceleration at a time (s), clamped to the profile's ends.
    #[must_use]
    pub fn at(&self, t: f64) -> (f64, f64, f64) {
        let t = t.clamp(0.0, self.duration);
        let index = self.pieces.partition_point(|piece| piece.begin <= t).saturating_sub(1);
        self.pieces
            .get(index)
            .map_or((0.0, 0.0, 0.0), |piece| piece.at(t - piece.begin))
    }
}

/// The phases that gain a speed (`sign` 1) or lose it (-1).
fn change(speed: f64, sign: f64, limits: &ProfileLimits) -> [Phase; 3] {
    let (peak, ramp, jerk) = match limits.jerk {
        Some(jerk) => {
            let peak = limits.acceleration.min((speed * jerk).sqrt());
            (peak, peak / jerk, sign * jerk)
        }
        None => (limits.acceleration, 0.0, 0.0),
    };
    let a = sign * peak;
    [(ramp, 0.0, jerk), (speed / peak - ramp, a, 0.0), (ramp, a, -jerk)]
}

impl Piece {
    fn at(&self, t: f64) -> (f64, f64, f64) {
        (
            self.distance + t * (self.v + t * (0.5 * self.a + t * self.jerk / 6.0)),
            self.v + t * (self.a + 0.5 * t * self.jerk),
            self.a + t * self.jerk,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn limits_hold_and_the_way_is_the_integral_of_the_speed(distance in 0.0..10.0_f64, speed in 0.05..3.0_f64, acceleration in 0.1..5.0_f64, jerk in prop::option::of(0.1..20.0_f64), stop in any::<bool>()) {
            let limits = ProfileLimits { speed, acceleration, jerk };
            let profile = if stop { Profile::to_rest(speed, &limits) } else { Profile::rest_to_rest(distance, &limits) };
            let steps = 2000;
            let dt = profile.duration() / f64::from(steps);
            let (mut distance, mut before) = (0.0, None);
            for i in 0..=steps {
                let (x, v, a) = profile.at(dt * f64::from(i));
                prop_assert!((-1e-9..=speed + 1e-9).contains(&v) && a.abs() <= acceleration + 1e-9);
                prop_assert!((x - distance).abs() < 1e-9 + 0.5 * acceleration * dt * dt, "{} {}", x, distance);
                if let (Some(before), Some(jerk)) = (before, jerk) {
                    let change: f64 = a - before;
                    prop_assert!(change.abs() <= jerk * dt + 1e-6 || (stop && i == 0));
                }
                before = Some(a);
                distance = x + profile.at(dt * (f64::from(i) + 0.5)).1 * dt;
            }
            let (_, v, _) = profile.at(profile.duration());
            prop_assert!(v.abs() < 1e-9);
            if !stop {
                prop_assert!((profile.distance() - distance).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn without_a_limit_of_the_jerk_it_is_a_trapezoid() {
        let limits = ProfileLimits {
            speed: 1.0,
            acceleration: 2.0,
            jerk: None,
        };
        assert!((Profile::rest_to_rest(3.0, &limits).duration() - 3.5).abs() < 1e-12);
        assert!((Profile::rest_to_rest(0.125, &limits).duration() - 0.5).abs() < 1e-12);
        assert_eq!(Profile::to_rest(1.0, &limits).distance(), 0.25);
    }
}
