//! `kiln check`: what a bake of a scene would take and warn of, within seconds.

use clap::Args;

use crate::console::{answer, put_json};
use crate::embedded::all_processors;
use crate::failure::{EXIT_CODES, Result};
use crate::forecast::Forecast;
use crate::kinds::KindTables;
use crate::settings::SettingsArguments;
use crate::submission::{PackedScene, SceneArguments};

/// Arguments of `kiln check`.
#[derive(Args, Debug)]
#[command(after_help = EXIT_CODES)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Prints one JSON object: scene, kind, instances, triangles, materials, textures, texture_pixels, texture_bytes, lights,
    /// cameras, bounds_m, lightmap, costs, warnings
    #[arg(long)]
    json: bool,
}

/// Prints the forecast; a scene that a bake would refuse is refused with the bake's words.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let wanted = arguments.settings.resolve(&kinds.contract)?;
    let bundle = PackedScene::read(&arguments.scene)?.into_bytes();
    let forecast = Forecast::of(kinds, &wanted, bundle)?;
    if arguments.json {
        let mut object = serde_json::json!(forecast);
        object["scene"] = arguments.scene.path.display().to_string().into();
        put_json(&object);
        return Ok(());
    }
    answer!("{}", words(&forecast));
    Ok(())
}

/// The forecast in lines for people.
fn words(forecast: &Forecast) -> String {
    let [low, high] = forecast.bounds_m;
    let size: Vec<String> = low.iter().zip(high).map(|(low, high)| format!("{:.4}", high - low)).collect();
    let mut lines = vec![
        format!(
            "scene       {} triangles in {} meshes, {} m",
            forecast.triangles,
            forecast.instances,
            size.join(" × ")
        ),
        format!(
            "materials   {} with {} textures of {:.1} Mpx",
            forecast.materials,
            forecast.textures,
            forecast.texture_pixels as f64 / 1e6
        ),
        format!("in the file {} lights, {} cameras", forecast.lights, forecast.cameras),
    ];
    if let Some(lightmap) = &forecast.lightmap {
        lines.push(format!(
            "lightmap    about {} receivers, texels of {} m, {} texels with gaps",
            lightmap.receivers, lightmap.texel_m, lightmap.texels
        ));
    }
    match &forecast.costs {
        Some(costs) => {
            let threads = all_processors();
            lines.extend([
                format!(
                    "time        about {} of processor time, {} on {threads} threads, in {} tasks",
                    duration(costs.cpu_secs),
                    duration(costs.cpu_secs / threads as f64),
                    costs.tasks
                ),
                format!("memory      about {}", size_of(costs.memory_bytes)),
                format!("bundle      about {}", size_of(costs.bundle_bytes)),
                format!("            by rates of {}: right within a factor of about three", costs.measured),
            ]);
        }
        None => {
            lines.push(format!("time        unknown: bakes of kind {} have not been measured", forecast.kind))
        }
    }
    lines.extend(forecast.warnings.iter().map(|warning| format!("warning: {}", warning.line())));
    lines.join("\n")
}

fn duration(secs: f64) -> String {
    match secs {
        _ if secs < 100.0 => format!("{secs:.0} s"),
        _ if secs < 6000.0 => format!("{:.0} min", secs / 60.0),
        _ => format!("{:.1} h", secs / 3600.0),
    }
}

fn size_of(bytes: u64) -> String {
    match bytes as f64 {
        bytes if bytes < 1e6 => format!("{:.0} kB", bytes / 1e3),
        bytes if bytes < 1e9 => format!("{:.1} MB", bytes / 1e6),
        bytes => format!("{:.1} GB", bytes / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_in_units_of_their_size() {
        assert_eq!([duration(9.0), duration(600.0), duration(7200.0)], ["9 s", "10 min", "2.0 h"]);
        assert_eq!([size_of(1234), size_of(5_600_000), size_of(7_800_000_000)], ["1 kB", "5.6 MB", "7.8 GB"]);
    }
}
