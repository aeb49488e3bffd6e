//! Outcomes of cases, in the JUnit XML that hosted services read.

use std::io::Write;

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};

use super::outcome::{Finding, Outcome};
use crate::{Error, Result};

/// The XML of all cases of a file, which `name` names.
///
/// # Errors
/// [`Error::Output`] if the XML cannot be made.
pub fn junit(name: &str, outcomes: &[Outcome]) -> Result<String> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    write(&mut writer, name, outcomes).map_err(|problem| Error::output("JUnit XML", problem))?;
    Ok(String::from_utf8_lossy(&writer.into_inner()).into_owned() + "\n")
}

fn write(writer: &mut Writer<impl Write>, name: &str, outcomes: &[Outcome]) -> std::io::Result<()> {
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    let count = |is: fn(&Finding) -> bool| outcomes.iter().filter(|o| is(&o.finding)).count().to_string();
    let counts = [
        ("tests", outcomes.len().to_string()),
        ("failures", count(|finding| matches!(finding, Finding::Failed(_)))),
        ("errors", count(|finding| matches!(finding, Finding::Broken(_)))),
        ("time", format!("{:.3}", outcomes.iter().map(|outcome| outcome.seconds).sum::<f64>())),
    ];
    let attributes = || counts.iter().map(|(name, value)| (*name, value.as_str()));
    let element = writer.create_element("testsuites").with_attribute(("name", "penumbra check"));
    element.with_attributes(attributes()).write_inner_content(|writer| {
        let suite = writer.create_element("testsuite").with_attribute(("name", name)).with_attributes(attributes());
        suite
            .write_inner_content(|writer| outcomes.iter().try_for_each(|outcome| write_case(writer, name, outcome)))?;
        Ok(())
    })?;
    Ok(())
}

fn write_case(writer: &mut Writer<impl Write>, suite: &str, outcome: &Outcome) -> std::io::Result<()> {
    let time = format!("{:.3}", outcome.seconds);
    let attributes = [("classname", suite), ("name", outcome.case.name.as_str()), ("time", time.as_str())];
    let case = writer.create_element("testcase").with_attributes(attributes);
    let kind = match outcome.finding {
        Finding::Passed | Finding::Blessed => {
            case.write_empty()?;
            return Ok(());
        }
        Finding::Failed(_) => "failure",
        Finding::Broken(_) => "error",
    };
    let reasons = outcome.reasons();
    case.write_inner_content(|writer| {
        let element = writer.create_element(kind).with_attribute(("message", reasons.as_str()));
        element.write_text_content(BytesText::new(&outcome.command))?;
        Ok(())
    })?;
    Ok(())
}
