// An Arduino Uno with the heater, cycle by cycle: the ATmega328P of simavr, in step with a model of the rig. It speaks as
// sketch/host.cpp does, one line in for every tick of 0.1 s; a clock that does not go on is that of timer 2, stopped.
//   in:   milliseconds degC(or nan) volt ampere_on ampere_off button [command]
//   out:  lines of the serial port, then "= count hold fed"
// Commands of the simulator: !hang, the program ends in a loop; !ones and !zeros, a wire of the converter is cut.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_spi.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_irq.h>

#include "board.h"

enum { OCR1A = 0x88, TCCR1A = 0x80, TIMSK2 = 0x70, LOOP = 0x7f00 };
enum { TIMER1_COMPB = 12, TIMER1_OVF = 13 };

static avr_t *avr;
static avr_timer_t *timer;
static double celsius = 25, volt = 12, on = 0, off = 0;
static int in_pulse = 1, ticks = 0, at = 0, wire = 0;
static uint8_t word[4];
static FILE *out;

// simavr knows no timer that counts up and down. Its timer 1 stands still; these are the interrupts of one with 510 steps:
// at the bottom, and twice at step 254.
static avr_cycle_count_t counted(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)unused;
  static const int STEPS[] = {254, 2, 254};
  static int part = 0;
  avr_raise_interrupt(of, part == 0 ? &timer->overflow : &timer->comp[AVR_TIMER_COMPB].interrupt);
  when += (avr_cycle_count_t)STEPS[part] * PWM_PRESCALER;
  part = (part + 1) % 3;
  return when;
}

static void ran(struct avr_irq_t *irq, uint32_t value, void *pulse) {
  (void)irq;
  if (value) in_pulse = pulse != NULL;
}

// The steps of the converter of the board, in mV at its pin.
static void triggered(struct avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  union {
    avr_adc_mux_t mux;
    uint32_t v;
  } asked = {.v = value};
  const double steps = asked.mux.src == 0 ? volt / VOLT_PER_STEP : AMPERE_ZERO + (in_pulse ? on : off) / AMPERE_PER_STEP;
  const double millivolt = fmin(fmax((steps + 0.5) * 5000 / 1024, 0), 4999);
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, asked.mux.src), (uint32_t)millivolt);
}

// A MAX31855: quarters of a kelvin in 14 bits, then the fault.
static void selected(struct avr_irq_t *irq, uint32_t high, void *unused) {
  (void)irq, (void)unused;
  if (high) return;
  at = 0;
  const int16_t quarters = isnan(celsius) ? 0 : (int16_t)lround(celsius * 4);
  const uint32_t bits = (uint32_t)(uint16_t)(quarters << 2) << 16 | (isnan(celsius) ? 0x10001u : 0);
  for (int k = 0; k < 4; ++k) word[k] = wire ? (wire > 0 ? 0xff : 0) : (uint8_t)(bits >> (24 - 8 * k));
}

static void sent(struct avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)value, (void)unused;
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_INPUT), word[at++ & 3]);
}

static void ticked(struct avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  if (value) ++ticks;
}

static void told(struct avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  static char line[400];
  static size_t length = 0;
  if (length < sizeof line - 2) line[length++] = (char)value;
  if (value != '\n') return;
  // Whole lines alone: a tick may end within one.
  fwrite(line, 1, length, out);
  length = 0;
}

// What drives the pin of the stop button; without, its pull-up would.
static void press(int high) {
  avr_ioport_external_t pin = {.name = 'D', .mask = 4, .value = high ? 4 : 0};
  avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &pin);
  avr_irq_t *irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 2);
  avr_raise_irq(irq, !high);
  avr_raise_irq(irq, high);
}

static void pass(double seconds) {
  const avr_cycle_count_t end = avr->cycle + (avr_cycle_count_t)(seconds * avr->frequency);
  while (avr->cycle < end) {
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) exit(3);
  }
}

static void report() {
  const int count = avr->data[TCCR1A] & 0x80 ? avr->data[OCR1A] : 0;
  fprintf(out, "= %d %d 1\n", count, ticks > 0);
  fflush(out);
  ticks = 0;
}

int main(int argc, char **argv) {
  // The library tells what it loads on the standard output.
  out = fdopen(dup(1), "w");
  dup2(2, 1);
  elf_firmware_t program = {0};
  if (argc < 2 || elf_read_firmware(argv[1], &program)) return 2;
  avr = avr_make_mcu_by_name("atmega328p");
  if (!avr) return 2;
  avr_init(avr);
  avr->log = LOG_ERROR;
  avr->frequency = 16000000;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr_load_firmware(avr, &program);
  avr->frequency = 16000000;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr->flash[LOOP] = 0xff, avr->flash[LOOP + 1] = 0xcf; // rjmp to itself
  for (avr_io_t *io = avr->io_port; io; io = io->next)
    if (!strcmp(io->kind, "timer") && ((avr_timer_t *)io)->name == '1') timer = (avr_timer_t *)io;
  for (unsigned k = 0; k < sizeof timer->cs / sizeof *timer->cs; ++k) timer->cs[k].reg = 0;
  avr_cycle_timer_register(avr, 1000, counted, NULL);
  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), told, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_OUTPUT), sent, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 2), selected, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 0), ticked, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), triggered, NULL);
  avr_irq_register_notify(avr_get_interrupt_irq(avr, TIMER1_OVF) + AVR_INT_IRQ_RUNNING, ran, avr);
  avr_irq_register_notify(avr_get_interrupt_irq(avr, TIMER1_COMPB) + AVR_INT_IRQ_RUNNING, ran, NULL);
  avr_irq_t *serial = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  press(0);
  pass(0.05);
  report();
  char line[320];
  unsigned long before = 0;
  while (fgets(line, sizeof line, stdin)) {
    int used = 0, pressed = 0;
    unsigned long clock = 0;
    char temperature[32], battery[32];
    if (sscanf(line, "%lu %31s %31s %lf %lf %d %n", &clock, temperature, battery, &on, &off, &pressed, &used) < 6) return 2;
    celsius = atof(temperature), volt = atof(battery);
    press(pressed != 0);
    if (before && clock == before) avr->data[TIMSK2] = 0;
    before = clock;
    // Long enough for the converters to see what is new.
    pass(0.03);
    const char *command = line + used;
    if (!strncmp(command, "!hang", 5)) avr->pc = LOOP;
    else if (!strncmp(command, "!ones", 5)) wire = 1;
    else if (!strncmp(command, "!zeros", 6)) wire = -1;
    else
      for (; *command > ' ' || *command == '\n'; ++command) avr_raise_irq(serial, (uint8_t)*command);
    pass(0.07);
    report();
  }
  return 0;
}
