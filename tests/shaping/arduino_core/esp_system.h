#ifndef ESP_SYSTEM_H
#define ESP_SYSTEM_H

typedef enum { ESP_RST_POWERON = 1, ESP_RST_TASK_WDT = 6, ESP_RST_WDT = 7 } esp_reset_reason_t;
esp_reset_reason_t esp_reset_reason();

#endif
