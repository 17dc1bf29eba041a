// Before anything is drawn, so that a dark page never flashes white.
try {
  const theme = localStorage.getItem('lampyris-theme');
  if (theme === 'light' || theme === 'dark') document.documentElement.dataset.theme = theme;
} catch {
  /* storage may be switched off: then the system's scheme holds */
}
