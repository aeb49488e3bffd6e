//! The attribute `kernel_test` of the crate `kernel-kit`, which re-exports it and documents it.
#![warn(missing_docs)]

use proc_macro::{Delimiter, Group, TokenStream, TokenTree};

/// Makes a test of a function that takes the tests' device. See `kernel_kit::kernel_test`.
#[proc_macro_attribute]
pub fn kernel_test(variable: TokenStream, function: TokenStream) -> TokenStream {
    let tokens: Vec<TokenTree> = function.into_iter().collect();
    let Some((head, tail)) = split(&tokens) else {
        return error("kernel_test makes tests of functions `fn name(gpu: &Gpu) { .. }`");
    };
    let (attributes, name) = (&head[..head.len() - 2], head[head.len() - 1].clone());
    let returned = &tail[1..tail.len() - 1];
    let variable = if variable.is_empty() { "::kernel_kit::test::VARIABLE".to_owned() } else { variable.to_string() };
    // The function as it is, inside one without parameters that calls it. Its tokens keep their places in the file.
    let device = parse(&format!("::kernel_kit::test::device({variable})"));
    let call = [name.clone(), Group::new(Delimiter::Parenthesis, device).into()];
    let body = head[head.len() - 2..].iter().chain(tail).cloned().chain(call).collect();
    let test = parse("#[cfg_attr(test, ::core::prelude::v1::test)] #[cfg_attr(not(test), allow(dead_code))] fn");
    let parameters = Group::new(Delimiter::Parenthesis, TokenStream::new());
    attributes
        .iter()
        .cloned()
        .chain(test)
        .chain([name, parameters.into()])
        .chain(returned.iter().cloned())
        .chain([Group::new(Delimiter::Brace, body).into()])
        .collect()
}

/// The tokens up to the function's name, and those from its parameters on.
fn split(tokens: &[TokenTree]) -> Option<(&[TokenTree], &[TokenTree])> {
    let is_fn = |token: &TokenTree| matches!(token, TokenTree::Ident(word) if word.to_string() == "fn");
    let name = tokens.iter().position(is_fn)? + 1;
    let (head, tail) = tokens.split_at_checked(name + 1)?;
    let whole = is_group(tail.first(), Delimiter::Parenthesis) && is_group(tail.last(), Delimiter::Brace);
    whole.then_some((head, tail))
}

fn is_group(token: Option<&TokenTree>, delimiter: Delimiter) -> bool {
    matches!(token, Some(TokenTree::Group(group)) if group.delimiter() == delimiter)
}

fn error(problem: &str) -> TokenStream {
    parse(&format!("::core::compile_error!({problem:?});"))
}

fn parse(text: &str) -> TokenStream {
    text.parse().expect("written here, and valid")
}
