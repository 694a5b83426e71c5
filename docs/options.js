// An option such as --clock stays whole at the end of a line.
for (const code of document.querySelectorAll(":not(pre) > code, code.language-sh")) {
    code.innerHTML = code.innerHTML.replace(/--[a-z-]+/g, '<span class="option">$&</span>');
}
