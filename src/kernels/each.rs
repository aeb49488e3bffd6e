//! `@each`: shaders that treat all lobes alike name none of them.

use kernel_kit::Feature as _;

use crate::specialisation::lobes::{LOBES, LobeFeature, LobeRole};

/// Repeats each statement, member or import that begins a line with `@each(GROUP)`, once for every lobe of the group,
/// from the lowest to the highest; with `@each_from_top(GROUP)`, from the highest to the lowest. `NAME` in it becomes
/// the name of the lobe's feature, and `Name` that of its type; `@each` becomes an `@if` of the feature, and keeps the
/// rest of the condition. So of
///
/// ```wgsl
///     @each(layer) NAME: Name,
///     @each(layer && textures) { factors.NAME = NAME_texture(factors.NAME, texel, texture); }
/// ```
///
/// kernels have
///
/// ```wgsl
///     @if(sheen) sheen: Sheen,
///     @if(clearcoat) clearcoat: Clearcoat,
///     @if(sheen && textures) { factors.sheen = sheen_texture(factors.sheen, texel, texture); }
///     @if(clearcoat && textures) { factors.clearcoat = clearcoat_texture(factors.clearcoat, texel, texture); }
/// ```
///
/// Groups are `lobe` (all of them), `layer` (both kinds of layers) and each `LobeRole` of
/// `src/specialisation/lobes.rs` in snake case. A line with another group stays, and does not compose.
pub fn expand_each(text: &str) -> String {
    let mut expanded = String::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let mut statement = format!("{line}\n");
        let Some(each) = Each::of(line) else {
            expanded += &statement;
            continue;
        };
        while statement.matches('{').count() > statement.matches('}').count()
            && let Some(line) = lines.next()
        {
            statement += line;
            statement += "\n";
        }
        for lobe in each.lobes() {
            let feature = lobe.feature.name();
            let own = statement.replacen(each.head, &format!("@if({feature}"), 1);
            // The type of a lobe has the name of the feature.
            expanded += &own.replace("NAME", feature).replace("Name", &format!("{:?}", lobe.feature));
        }
    }
    expanded
}

/// How a line begins that is to be repeated.
struct Each<'t> {
    /// Up to the end of the group's name.
    head: &'t str,
    roles: &'static [LobeRole],
    from_top: bool,
}

impl Each<'_> {
    fn of(line: &str) -> Option<Each<'_>> {
        let line = line.trim_start();
        let (begin, rest) = line.split_once('(')?;
        let from_top = match begin {
            "@each" => false,
            "@each_from_top" => true,
            _ => return None,
        };
        let group = rest.split([' ', ')']).next()?;
        Some(Each { head: &line[..begin.len() + 1 + group.len()], roles: roles(group)?, from_top })
    }

    fn lobes(&self) -> Vec<&'static LobeFeature> {
        let is_meant = |lobe: &&LobeFeature| lobe.role.is_some_and(|role| self.roles.contains(&role));
        let mut lobes: Vec<_> = LOBES.iter().filter(is_meant).collect();
        if self.from_top {
            lobes.reverse();
        }
        lobes
    }
}

/// The roles of a group; `None` if there is no such group.
fn roles(group: &str) -> Option<&'static [LobeRole]> {
    use LobeRole::{Base, Film, GlossyLayer, Spread, WideLayer};
    match group {
        "lobe" => Some(&[Base, Film, Spread, WideLayer, GlossyLayer]),
        "layer" => Some(&[WideLayer, GlossyLayer]),
        "base" => Some(&[Base]),
        "film" => Some(&[Film]),
        "spread" => Some(&[Spread]),
        "wide_layer" => Some(&[WideLayer]),
        "glossy_layer" => Some(&[GlossyLayer]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines of the lobes are those that would be written by hand; other lines stay.
    #[test]
    fn lines_are_repeated_for_the_lobes_of_a_group() {
        let text = "\
@each(layer) import package::lib::bsdf::NAME::{
    Name, NAME_mean,
};
struct Surface {
    albedo: vec3f,
    @each(film && textures) NAME: NameFactors,
}
    @each_from_top(layer) {
        value += NAME_value(s.NAME);
    }
    @each_from_top(wide_layer) { value *= 2.0; }
    return value;
";
        let expected = "\
@if(sheen) import package::lib::bsdf::sheen::{
    Sheen, sheen_mean,
};
@if(clearcoat) import package::lib::bsdf::clearcoat::{
    Clearcoat, clearcoat_mean,
};
struct Surface {
    albedo: vec3f,
    @if(iridescence && textures) iridescence: IridescenceFactors,
}
    @if(clearcoat) {
        value += clearcoat_value(s.clearcoat);
    }
    @if(sheen) {
        value += sheen_value(s.sheen);
    }
    @if(sheen) { value *= 2.0; }
    return value;
";
        assert_eq!(expand_each(text), expected);
    }

    /// A group that there is not is not taken for an empty one: the line stays, and the kernel does not compose.
    #[test]
    fn unknown_groups_do_not_compose() {
        let text = "@compute @workgroup_size(1) fn nothing() {\n    @each(layers) { return; }\n}\n";
        assert_eq!(expand_each(text), text);
        let composer = kernel_kit::Composer::new();
        let features = kernel_kit::Features::none();
        assert!(composer.compose_source("nothing", &text.replace("@each(layers)", ""), &features).is_ok());
        assert!(composer.compose_source("nothing", text, &features).is_err());
    }

    /// Glossy layers lie above wide ones, as the shaders take them.
    #[test]
    fn layers_are_listed_from_below() {
        let roles: Vec<_> = LOBES.iter().filter_map(|lobe| lobe.role).collect();
        let first_glossy = roles.iter().position(|role| *role == LobeRole::GlossyLayer).unwrap();
        let last_wide = roles.iter().rposition(|role| *role == LobeRole::WideLayer).unwrap();
        assert!(last_wide < first_glossy, "{roles:?}");
    }
}
