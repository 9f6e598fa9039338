//! The summary that a person wants to read.

use std::fmt::Write;
use std::path::Path;

use enf_stage::CommonArgs;
use serde_json::Value;

/// 1234567 as "1,234,567".
fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

fn number(value: &Value, key: &str) -> f64 {
    key.split('.').try_fold(value, |v, k| v.get(k)).and_then(Value::as_f64).unwrap_or(0.0)
}

fn mib(bytes: f64) -> f64 {
    bytes / f64::from(1 << 20)
}

/// The text of `summary.txt`.
pub(crate) fn text(
    scene: &Path,
    store: &Path,
    common: &CommonArgs,
    stages: &[Value],
    report: &Value,
) -> String {
    let mut s = String::new();
    let stage =
        |name: &str| stages.iter().find(|v| v["stage"] == name).cloned().unwrap_or(Value::Null);
    let (partition, trace, render) = (stage("partition"), stage("trace"), stage("render"));
    let count = |v: &Value, key: &str| grouped(number(v, key) as u64);
    // Writing to a string cannot fail.
    let _ = writeln!(s, "{}", crate::pipeline::store_stem(scene));
    let _ = writeln!(
        s,
        "  building   {} triangles in {} rooms, {} doors and openings ({:.1} m2), {} lights",
        count(&partition, "triangles"),
        count(&partition, "rooms"),
        count(&partition, "portals"),
        number(&partition, "portal_area_m2"),
        count(&partition, "lights"),
    );
    let _ = writeln!(
        s,
        "  rooms      {} triangles on average, {} in the fullest; {} tiles in memory one at a time",
        count(&partition, "room_triangles_mean"),
        count(&partition, "room_triangles_max"),
        count(&partition, "tiles"),
    );
    if number(&trace, "photons_emitted") > 0.0 {
        let emitted = number(&trace, "photons_emitted");
        let _ = writeln!(
            s,
            "  photons    {} emitted = {} absorbed + {} escaped; {} impacts stored",
            count(&trace, "photons_emitted"),
            count(&trace, "photons_absorbed"),
            count(&trace, "photons_escaped"),
            count(&trace, "photons_stored"),
        );
        let _ = writeln!(
            s,
            "  light      {:.0} lm emitted; {:.1} % absorbed, {:.1} % escaped; {:.2} reflections a photon (at most {}); \
             {:.2} passages through a door or opening per photon",
            number(&trace, "flux_emitted_w") * 179.0,
            100.0 * number(&trace, "flux_absorbed_w") / number(&trace, "flux_emitted_w"),
            100.0 * number(&trace, "flux_escaped_w") / number(&trace, "flux_emitted_w"),
            number(&trace, "reflections_mean"),
            count(&trace, "reflections_max"),
            number(&trace, "photons_through_portals") / emitted,
        );
        let _ = writeln!(
            s,
            "  loads      {:.2} per tile on average, {} at most",
            number(&trace, "io.room_load_mean"),
            count(&trace, "io.room_load_max"),
        );
    }
    if number(&render, "rays_camera") > 0.0 {
        let _ = writeln!(
            s,
            "  rays       {} from cameras, {} to lights, {} gathers",
            count(&render, "rays_camera"),
            count(&render, "rays_shadow"),
            count(&render, "rays_gather"),
        );
    }
    let _ = writeln!(
        s,
        "  memory     {:.0} MiB at most, of the {} MiB allowed",
        mib(number(report, "memory.peak_resident_bytes")),
        common.memory >> 20,
    );
    let _ = writeln!(
        s,
        "  disk       {:.0} MiB read, {:.0} MiB written",
        mib(number(report, "io.read_bytes")),
        mib(number(report, "io.written_bytes")),
    );
    let _ =
        write!(s, "  time       {:.1} s on {} threads:", number(report, "wall_s"), common.threads);
    for stage in stages {
        let _ =
            write!(s, " {} {:.1}", stage["stage"].as_str().unwrap_or("?"), number(stage, "wall_s"));
    }
    let _ = writeln!(s);
    if let Some(pictures) = render["pictures"].as_array() {
        let names: Vec<&str> = pictures.iter().filter_map(Value::as_str).collect();
        let _ = writeln!(s, "  pictures   {}", names.join("\n             "));
    }
    let _ = writeln!(s, "  store      {}", store.display());
    s
}

#[cfg(test)]
mod tests {
    use super::grouped;

    #[test]
    fn thousands_are_grouped() {
        assert_eq!(grouped(0), "0");
        assert_eq!(grouped(999), "999");
        assert_eq!(grouped(336_500), "336,500");
        assert_eq!(grouped(1_074_000_000), "1,074,000,000");
    }
}
