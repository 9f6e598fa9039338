//! Where the sun stands.
//!
//! The low-accuracy position of Meeus 1998, "Astronomical Algorithms", chapters 12, 22 and 25 (0.01 degrees), and the
//! refraction of NOAA's solar calculator, which uses the same chapters.

use glam::DVec3;

/// The sun at one moment at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// Degrees clockwise from true north.
    pub azimuth: f64,
    /// Degrees above the horizon, refraction included.
    pub altitude: f64,
}

/// A moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Year of the Gregorian calendar.
    pub year: i32,
    /// Month, 1 to 12.
    pub month: u32,
    /// Day of the month, from 1.
    pub day: u32,
    /// Hours after midnight by the clock.
    pub hours: f64,
    /// Hours by which that clock is ahead of UTC.
    pub timezone: f64,
}

/// Number of days of a month; 0 for a month that there is not.
pub fn days_of(year: i32, month: u32) -> u32 {
    let leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
    match month {
        1 | 3 | 5 | 7 | 8 | 10 | 12 => 31,
        4 | 6 | 9 | 11 => 30,
        2 if leap => 29,
        2 => 28,
        _ => 0,
    }
}

impl Moment {
    /// Day of the year, from 1.
    pub fn day_of_year(&self) -> u32 {
        (1..self.month).map(|m| days_of(self.year, m)).sum::<u32>() + self.day
    }

    /// Julian day number, with its fraction (Meeus, chapter 7).
    pub fn julian_day(&self) -> f64 {
        let (mut y, mut m) = (f64::from(self.year), f64::from(self.month));
        if self.month <= 2 {
            y -= 1.0;
            m += 12.0;
        }
        let century = (y / 100.0).floor();
        let leap = 2.0 - century + (century / 4.0).floor();
        let day = (365.25 * (y + 4716.0)).floor() + (30.6001 * (m + 1.0)).floor();
        day + f64::from(self.day) + leap - 1524.5 + (self.hours - self.timezone) / 24.0
    }
}

/// Right ascension and declination of the apparent sun, degrees, at a Julian day (Meeus, chapter 25).
pub fn equatorial(julian_day: f64) -> (f64, f64) {
    let t = (julian_day - 2451545.0) / 36525.0;
    let mean_longitude = 280.46646 + t * (36000.76983 + t * 0.0003032);
    let anomaly = (357.52911 + t * (35999.05029 - t * 0.0001537)).to_radians();
    let centre = (1.914602 - t * (0.004817 + t * 0.000014)) * libm::sin(anomaly)
        + (0.019993 - t * 0.000101) * libm::sin(2.0 * anomaly)
        + 0.000289 * libm::sin(3.0 * anomaly);
    let node = (125.04 - 1934.136 * t).to_radians();
    // Aberration and nutation.
    let longitude = (mean_longitude + centre - 0.00569 - 0.00478 * libm::sin(node)).to_radians();
    let obliquity = 23.439291 - t * (0.0130042 + t * (0.00000016 - t * 0.000000504));
    let obliquity = (obliquity + 0.00256 * libm::cos(node)).to_radians();
    let (sin, cos) = libm::sincos(longitude);
    let ascension = libm::atan2(libm::cos(obliquity) * sin, cos).to_degrees();
    let declination = libm::asin(libm::sin(obliquity) * sin).to_degrees();
    (ascension.rem_euclid(360.0), declination)
}

/// The sun's place in the sky at a moment; latitude (north) and longitude (east) in degrees.
pub fn position(moment: &Moment, latitude: f64, longitude: f64) -> Position {
    let day = moment.julian_day();
    let (ascension, declination) = equatorial(day);
    let t = (day - 2451545.0) / 36525.0;
    // Sidereal time at Greenwich (Meeus, chapter 12).
    let sidereal = 280.46061837 + 360.98564736629 * (day - 2451545.0) + t * t * 0.000387933;
    let hour = (sidereal + longitude - ascension).rem_euclid(360.0).to_radians();
    let (sin_h, cos_h) = libm::sincos(hour);
    let (sin_l, cos_l) = libm::sincos(latitude.to_radians());
    let (sin_d, cos_d) = libm::sincos(declination.to_radians());
    let up = sin_l * sin_d + cos_l * cos_d * cos_h;
    let north = cos_l * sin_d - sin_l * cos_d * cos_h;
    let east = -cos_d * sin_h;
    let altitude = libm::atan2(up, libm::sqrt(north * north + east * east)).to_degrees();
    Position {
        azimuth: libm::atan2(east, north).to_degrees().rem_euclid(360.0),
        altitude: altitude + refraction(altitude),
    }
}

/// By how many degrees the atmosphere lifts what stands at an altitude (degrees, without refraction).
fn refraction(altitude: f64) -> f64 {
    let tan = libm::tan(altitude.to_radians());
    let seconds = if altitude > 85.0 {
        0.0
    } else if altitude > 5.0 {
        58.1 / tan - 0.07 / (tan * tan * tan) + 0.000086 / (tan * tan * tan * tan * tan)
    } else if altitude > -0.575 {
        1735.0 + altitude * (-518.2 + altitude * (103.4 + altitude * (-12.79 + altitude * 0.711)))
    } else {
        -20.772 / tan
    };
    seconds / 3600.0
}

/// Unit vector to the sun in a scene in which true north is `north` degrees clockwise from +y, seen from above.
pub fn direction(position: &Position, north: f64) -> DVec3 {
    let (sin, cos) = libm::sincos((position.azimuth + north).to_radians());
    let (up, level) = libm::sincos(position.altitude.to_radians());
    DVec3::new(sin * level, cos * level, up)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Meeus, example 25.a: 1992 October 13, 0h TD.
    #[test]
    fn meeus_example() {
        let moment = Moment { year: 1992, month: 10, day: 13, hours: 0.0, timezone: 0.0 };
        assert_eq!(moment.julian_day(), 2448908.5);
        let (ascension, declination) = equatorial(moment.julian_day());
        assert!((ascension - 198.38083).abs() < 1e-4, "{ascension}");
        assert!((declination + 7.78507).abs() < 1e-4, "{declination}");
    }

    /// Reda and Andreas 2008, "Solar position algorithm for solar radiation applications" (NREL/TP-560-34302), appendix
    /// A.5: zenith distance 50.11162, azimuth 194.34024 degrees.
    #[test]
    fn nrel_example() {
        let hours = 12.0 + 30.5 / 60.0;
        let moment = Moment { year: 2003, month: 10, day: 17, hours, timezone: -7.0 };
        let sun = position(&moment, 39.742476, -105.1786);
        assert!((sun.azimuth - 194.34024).abs() < 0.01, "{sun:?}");
        assert!((90.0 - sun.altitude - 50.11162).abs() < 0.01, "{sun:?}");
        assert_eq!(moment.day_of_year(), 290);
    }

    /// At the equinox the sun rises due east; at solar noon in the south it stands in the north.
    #[test]
    fn compass() {
        let noon = Moment { year: 2026, month: 12, day: 21, hours: 12.0, timezone: 10.0 };
        let sydney = position(&noon, -33.87, 151.21);
        assert!(sydney.altitude > 75.0);
        assert!(sydney.azimuth < 60.0 || sydney.azimuth > 300.0, "{sydney:?}");
        let east = Position { azimuth: 90.0, altitude: 0.0 };
        assert!((direction(&east, 0.0) - DVec3::X).length() < 1e-12);
        assert!((direction(&east, 90.0) + DVec3::Y).length() < 1e-12);
        let north = Position { azimuth: 0.0, altitude: 0.0 };
        assert!((direction(&north, 0.0) - DVec3::Y).length() < 1e-12);
        assert_eq!(days_of(2000, 2) + days_of(1900, 2) + days_of(2024, 2) + days_of(2026, 2), 114);
    }
}
