//! `[sky]`: which sky, how bright, and where its sun stands.

use crate::{
    SceneError,
    file::{LUMENS_PER_WATT, Parsed, Rgb, SceneFile},
};
use enf_daylight::{
    Amount, Model, Pattern,
    sun::{self, Moment, Position},
};
use enf_layout::sky::SkyRecord;
use glam::DVec3;
use serde::Deserialize;
use toml::Value;

/// Lumens in a watt of daylight over the whole spectrum, where Perez's sky is asked for by illuminances.
const BROADBAND_EFFICACY: f64 = 115.0;
/// Reflectance of the ground unless the scene says so.
const GROUND: f64 = 0.2;

/// The table as it stands in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SkyTable {
    model: String,
    diffuse_horizontal: Option<f64>,
    diffuse_horizontal_lux: Option<f64>,
    direct_normal: Option<f64>,
    direct_normal_lux: Option<f64>,
    efficacy: Option<f64>,
    sun: Option<[f64; 2]>,
    date: Option<Value>,
    time: Option<Value>,
    latitude: Option<f64>,
    longitude: Option<f64>,
    timezone: Option<f64>,
    north: Option<f64>,
    ground: Option<Rgb>,
    color: Option<Rgb>,
    sun_color: Option<Rgb>,
}

/// What is wrong, and the way out.
type Problem = (String, &'static str);

/// The sky of a scene file, in store coordinates; `None` without a `[sky]`.
pub(crate) fn build(parsed: &Parsed<SceneFile>) -> Result<Option<SkyRecord>, SceneError> {
    let Some(at) = &parsed.value.sky else { return Ok(None) };
    match at.get_ref().record() {
        Ok(record) => Ok(Some(record)),
        Err((what, remedy)) => Err(parsed.error(at, format!("[sky]: {what}"), remedy)),
    }
}

impl SkyTable {
    fn record(&self) -> Result<SkyRecord, Problem> {
        let Some(model) = Model::parse(&self.model) else {
            return Err((
                format!("there is no model \"{}\"", self.model),
                "give \"cie-1\" to \"cie-16\", \"uniform\" or \"perez\"",
            ));
        };
        let efficacy = self.efficacy;
        if efficacy.is_some_and(|e| !(1.0..=683.0).contains(&e)) {
            return Err(("\"efficacy\" is out of range".into(), "give lumens a watt, such as 115"));
        }
        let diffuse = amount(
            "diffuse_horizontal",
            self.diffuse_horizontal,
            self.diffuse_horizontal_lux,
            efficacy,
        )?
        .ok_or((
            "how bright is it?".to_string(),
            "give \"diffuse_horizontal\" (W/m2) or \"diffuse_horizontal_lux\"",
        ))?;
        let direct = amount("direct_normal", self.direct_normal, self.direct_normal_lux, efficacy)?
            .unwrap_or_default();
        if diffuse.visible <= 0.0 && direct.visible <= 0.0 {
            return Err(("it is dark".into(), "give irradiances above 0, or leave [sky] out"));
        }
        let place = self.sun()?;
        let needed = model.needs_sun() || direct.visible > 0.0;
        let why = if model.needs_sun() {
            format!("the model \"{}\"", self.model)
        } else {
            "direct light".to_string()
        };
        let (direction, day) = match place {
            None if needed => {
                return Err((
                    format!("{why} needs to know where the sun stands"),
                    "give sun = [azimuth, altitude], or date, time, latitude, longitude and timezone",
                ));
            }
            Some((position, _)) if needed && position.altitude <= 0.0 => {
                return Err((
                    format!(
                        "{why} needs a sun above the horizon, and it stands {:.1} degrees below it",
                        -position.altitude
                    ),
                    "choose another hour, or a model that needs no sun (cie-1, cie-3, cie-5, cie-16, uniform)",
                ));
            }
            None => (DVec3::ZERO, None),
            Some((position, day)) => (sun::direction(&position, self.north()?), day),
        };
        let pattern = match model {
            Model::Uniform => Pattern::UNIFORM,
            Model::Cie(number) => Pattern::cie(number),
            Model::Perez => {
                let zenith = libm::acos(direction.z.clamp(-1.0, 1.0));
                Pattern::perez(zenith, diffuse.broadband, direct.broadband, day)
                    .map_err(|e| (e.to_string(), "give \"diffuse_horizontal\""))?
            }
        };
        let rgb = |c: Option<Rgb>, missing: f64| c.map_or([missing; 3], |c| c.values());
        let ground = rgb(self.ground, GROUND);
        if ground.iter().any(|&g| g > 1.0) {
            return Err((
                "\"ground\" reflects more than it gets".into(),
                "give reflectances from 0 to 1",
            ));
        }
        let (color, sun_color) = (rgb(self.color, 1.0), rgb(self.sun_color, 1.0));
        for (name, of) in [("color", color), ("sun_color", sun_color)] {
            if crate::luminance(of) <= 0.0 {
                return Err((format!("\"{name}\" is black"), "give a colour above 0"));
            }
        }
        let amount =
            Amount { diffuse: diffuse.visible, direct: direct.visible, ground, color, sun_color };
        Ok(enf_daylight::record(&pattern, direction, &amount))
    }

    fn north(&self) -> Result<f64, Problem> {
        in_range(
            "north",
            self.north.unwrap_or(0.0),
            360.0,
            "give degrees clockwise from +y, seen from above",
        )
    }

    /// The sun, and the day of the year if a date is given.
    fn sun(&self) -> Result<Option<(Position, Option<u32>)>, Problem> {
        self.north()?;
        let moment = [
            ("date", self.date.is_some()),
            ("time", self.time.is_some()),
            ("latitude", self.latitude.is_some()),
            ("longitude", self.longitude.is_some()),
            ("timezone", self.timezone.is_some()),
        ];
        let given = moment.iter().any(|m| m.1);
        if let Some([azimuth, altitude]) = self.sun {
            if let Some((name, _)) = moment.iter().find(|m| m.1) {
                return Err((format!("both \"sun\" and \"{name}\""), "give one of them"));
            }
            let azimuth =
                in_range("sun", azimuth, 360.0, "give the azimuth clockwise from north, degrees")?;
            let altitude =
                in_range("sun", altitude, 90.0, "give the altitude above the horizon, degrees")?;
            return Ok(Some((Position { azimuth, altitude }, None)));
        }
        if !given {
            return Ok(None);
        }
        let (Some(date), Some(time), Some(latitude), Some(longitude), Some(timezone)) =
            (&self.date, &self.time, self.latitude, self.longitude, self.timezone)
        else {
            let missing = moment.iter().find(|m| !m.1).map_or("sun", |m| m.0);
            return Err((
                format!("\"{missing}\" is missing"),
                "the sun's place takes date, time, latitude, longitude and timezone",
            ));
        };
        let latitude = in_range("latitude", latitude, 90.0, "give degrees, north positive")?;
        let longitude = in_range("longitude", longitude, 180.0, "give degrees, east positive")?;
        let timezone = in_range("timezone", timezone, 14.0, "give hours ahead of UTC")?;
        let (year, month, day) = read_date(&text(date))
            .ok_or_else(|| (format!("{} is no date", text(date)), "write date = 2026-06-21"))?;
        let hours = read_time(&text(time)).ok_or_else(|| {
            (format!("{} is no time of the day", text(time)), "write time = 14:30:00")
        })?;
        let moment = Moment { year, month, day, hours, timezone };
        let position = sun::position(&moment, latitude, longitude);
        Ok(Some((position, Some(moment.day_of_year()))))
    }
}

/// An irradiance.
#[derive(Clone, Copy, Default)]
struct Irradiance {
    /// As the renderer counts it, 179 lumens a watt.
    visible: f64,
    /// Over the whole spectrum, as weather records have it.
    broadband: f64,
}

fn amount(
    name: &str,
    watts: Option<f64>,
    lux: Option<f64>,
    efficacy: Option<f64>,
) -> Result<Option<Irradiance>, Problem> {
    let found = match (watts, lux) {
        (None, None) => return Ok(None),
        (Some(_), Some(_)) => {
            return Err((format!("both \"{name}\" and \"{name}_lux\""), "give one of them"));
        }
        (Some(w), None) => Irradiance {
            visible: w * efficacy.unwrap_or(LUMENS_PER_WATT) / LUMENS_PER_WATT,
            broadband: w,
        },
        (None, Some(lx)) => Irradiance {
            visible: lx / LUMENS_PER_WATT,
            broadband: lx / efficacy.unwrap_or(BROADBAND_EFFICACY),
        },
    };
    if !(0.0..=1e9).contains(&found.visible) {
        return Err((format!("\"{name}\" is out of range"), "give 0 or more"));
    }
    Ok(Some(found))
}

fn in_range(name: &str, value: f64, limit: f64, remedy: &'static str) -> Result<f64, Problem> {
    if value.is_finite() && value.abs() <= limit {
        return Ok(value);
    }
    Err((format!("\"{name}\" has {value}, which is out of range"), remedy))
}

/// A TOML date or time, or a string with one.
fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.trim().into(),
        other => other.to_string(),
    }
}

fn read_date(text: &str) -> Option<(i32, u32, u32)> {
    let parts: Vec<u32> = numbers(text, '-')?;
    let &[year, month, day] = parts.as_slice() else { return None };
    let year = i32::try_from(year).ok().filter(|y| (1000..=9999).contains(y))?;
    (day >= 1 && day <= sun::days_of(year, month)).then_some((year, month, day))
}

fn read_time(text: &str) -> Option<f64> {
    let whole = text.split('.').next()?;
    let parts: Vec<u32> = numbers(whole, ':')?;
    let (hour, minute, second) = match *parts.as_slice() {
        [h, m] => (h, m, 0),
        [h, m, s] => (h, m, s),
        _ => return None,
    };
    let usable = hour < 24 && minute < 60 && second < 60;
    usable.then(|| f64::from(hour) + f64::from(minute) / 60.0 + f64::from(second) / 3600.0)
}

fn numbers(text: &str, separator: char) -> Option<Vec<u32>> {
    let digits = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    text.split(separator).map(|p| if digits(p) { p.parse().ok() } else { None }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_times() {
        assert_eq!(read_date("2026-06-21"), Some((2026, 6, 21)));
        assert_eq!(read_date("2026-02-29"), None);
        assert_eq!(read_date("2026-13-01"), None);
        assert_eq!(read_date("21.6.2026"), None);
        assert_eq!(read_date("2026-06-21T12:00:00"), None);
        assert_eq!(read_time("14:30"), Some(14.5));
        assert_eq!(read_time("14:30:36"), Some(14.51));
        assert_eq!(read_time("24:00"), None);
        assert_eq!(read_time("+4:00"), None);
    }
}
